#!/usr/bin/env bash
# A study on one machine or several through GNU parallel: one shard a job.
#
#   tools/cluster/study_parallel.sh my_study.nml 16              # 16 shards on this machine
#   tools/cluster/study_parallel.sh my_study.nml 64 --sshlogin node1,node2 --workdir .
#
# Further words go to parallel. Started again, it does only what is missing.
set -eu
castnet=${CASTNET:-castnet}
study=${1:?which study file?}
shards=${2:?how many shards?}
shift 2
seq "$shards" | parallel --halt now,fail=1 --quote "$@" \
  "$castnet" study "$study" --shard "{}/$shards" --threads 1 --quiet
"$castnet" collect "$study"
