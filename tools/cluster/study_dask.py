#!/usr/bin/env python3
"""A study through Dask: one shard a task, on this machine or on a cluster of yours.

    python3 tools/cluster/study_dask.py my_study.nml 16
    python3 tools/cluster/study_dask.py my_study.nml 64 --scheduler tcp://head:8786

The workers must see the study's folder. Started again, it does only what is missing.
Needs the package `distributed` (pip install distributed).
"""
import argparse
import subprocess

from dask.distributed import Client, as_completed


def run_shard(castnet, study, k, n):
    return subprocess.run([castnet, "study", study, "--shard", f"{k}/{n}", "--threads", "1", "--quiet"],
                          capture_output=True, text=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study")
    parser.add_argument("shards", type=int)
    parser.add_argument("--castnet", default="castnet")
    parser.add_argument("--scheduler", help="address of a Dask scheduler; default: workers on this machine")
    a = parser.parse_args()
    client = Client(a.scheduler) if a.scheduler else Client(threads_per_worker=1)
    tasks = client.map(lambda k: run_shard(a.castnet, a.study, k, a.shards), range(1, a.shards + 1), pure=False)
    bad = [t.result() for t in as_completed(tasks) if t.result().returncode != 0]
    client.close()
    if bad:
        raise SystemExit(bad[0].stderr)
    raise SystemExit(subprocess.run([a.castnet, "collect", a.study]).returncode)


if __name__ == "__main__":
    main()
