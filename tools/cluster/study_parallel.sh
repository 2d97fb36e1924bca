#!/usr/bin/env bash
# A study on one machine or several through GNU parallel: one shard a job.
#
#   tools/cluster/study_parallel.sh my_study.nml 16              # 16 shards, a job for each core
#   tools/cluster/study_parallel.sh my_study.nml 16 -j 4         # four at a time
#   tools/cluster/study_parallel.sh my_study.nml 64 --sshlogin node1,node2 --workdir .
#
# Further words go to parallel; CASTNET says which program, CASTNET_OPTIONS what else it is
# told (each shard and the final collect). Started again, it does only what is missing.
set -eu
castnet=${CASTNET:-castnet}
study=${1:?which study file?}
shards=${2:?how many shards?}
shift 2
read -r -a options <<<"${CASTNET_OPTIONS:-}"
seq "$shards" | parallel --will-cite --halt now,fail=1 --quote "$@" \
  "$castnet" study "$study" --shard "{}/$shards" --threads 1 --quiet ${options[@]+"${options[@]}"}
"$castnet" collect "$study" ${options[@]+"${options[@]}"}
