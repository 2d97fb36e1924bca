#!/usr/bin/env python3
"""A study through Dask: one shard a task, on this machine or on a cluster of yours.

    python3 tools/cluster/study_dask.py my_study.nml 16
    python3 tools/cluster/study_dask.py my_study.nml 64 --scheduler tcp://head:8786
    python3 tools/cluster/study_dask.py my_study.nml 16 -- --output out/table.h5

Words after -- go to castnet, for every shard and for `collect`. The workers must see the
study's folder under the same path, and castnet. A shard on a worker that dies is run again
by Dask and does only what is missing; so does this script when it is started again.
Needs the package `distributed` (pip install distributed).
"""
import argparse
import os
import shutil
import subprocess
import sys

try:
    from dask.distributed import Client, LocalCluster, as_completed
except ImportError:
    sys.exit("study_dask.py needs the package distributed: pip install distributed")


def run_shard(castnet, study, k, n, words, folder):
    """Exit code and last words of one shard; runs on a worker."""
    done = subprocess.run([castnet, "study", study, "--shard", f"{k}/{n}", "--threads", "1", "--quiet", *words],
                          cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    return k, done.returncode, done.stderr.strip()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study")
    parser.add_argument("shards", type=int)
    parser.add_argument("--castnet", default=os.environ.get("CASTNET", "castnet"), help="the program, as the workers find it")
    parser.add_argument("--scheduler", help="address of a Dask scheduler; default: a worker for each core here")
    said = sys.argv[1:]
    cut = said.index("--") if "--" in said else len(said)
    a, words = parser.parse_args(said[:cut]), said[cut + 1:]
    # The workers' own folder is another one: paths that are seen from here are made whole.
    study, castnet, folder = os.path.abspath(a.study), a.castnet, os.getcwd()
    if os.sep in castnet or not a.scheduler:
        castnet = os.path.abspath(shutil.which(castnet) or sys.exit(f"there is no program {castnet}; say where with --castnet"))
    if not os.path.isfile(study):
        sys.exit(f"there is no study {a.study}")
    cluster = None if a.scheduler else LocalCluster(n_workers=len(os.sched_getaffinity(0)), threads_per_worker=1,
                                                    dashboard_address=None)
    bad = []
    with Client(a.scheduler or cluster) as client:
        tasks = [client.submit(run_shard, castnet, study, k, a.shards, words, folder, pure=False)
                 for k in range(1, a.shards + 1)]
        for task in as_completed(tasks):
            if task.status != "finished":
                bad.append(f"a shard was lost: {task.exception()!r}")
                continue
            k, code, told = task.result()
            if code != 0:
                bad.append(f"shard {k}/{a.shards}: exit {code}\n{told}")
    if cluster is not None:
        cluster.close()
    if bad:
        sys.exit("\n".join(bad[:3]) + f"\n{len(bad)} of {a.shards} shards did not end; started again, this does only what is missing")
    sys.exit(subprocess.run([castnet, "collect", study, *words], check=False).returncode)


if __name__ == "__main__":
    main()
