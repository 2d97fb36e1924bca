#!/usr/bin/env python3
"""A study through a Slurm job array on a real one-node Slurm, with a task that is stopped
by USR1 and puts itself back into the queue: the same bits as without Slurm. GNU parallel
does the same. Where Slurm cannot be started (not root, no package) the reason is printed.

Usage: python3 test/system/test_slurm.py CASTNET
"""
import os
import shutil
import subprocess
import sys
import tempfile
import time

import h5py
import numpy as np

CASTNET = os.path.abspath(sys.argv[1])
ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
passed = failed = 0

CONF = """ClusterName=local
SlurmctldHost={host}(127.0.0.1)
AuthType=auth/munge
CredType=cred/munge
SlurmUser=root
SlurmdUser=root
StateSaveLocation={dir}/state
SlurmdSpoolDir={dir}/spool
SlurmctldPidFile={dir}/slurmctld.pid
SlurmdPidFile={dir}/slurmd.pid
SlurmctldLogFile={dir}/log/slurmctld.log
SlurmdLogFile={dir}/log/slurmd.log
SlurmctldPort=16817
SlurmdPort=16818
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
SlurmdTimeout=60
KillWait=5
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory=2000 State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""
SCENE = """
&net squares = 4, 4 mesh_length = 0.175 cable_diameter = 1e-3 edge_cable_diameter = 3e-3 /
&bullets mass = 0.03 speed = 1.8 /
&target shape = 'box' dimensions = 0.1, 0.1, 0.3 mass = 3.5 position = 0.5, 0, 0 /
&contact threshold = 2e-3 /
&time end_time = 2.0 step = 1e-5 /
&perturb node_position = 1e-5 /
"""
STUDY = "&study scene = 'scene.nml' seed = 11 seeds = 30 /\n&vary key = 'target/angular_velocity(2)' values = 1.0, 2.0 /\n"


def check(condition, words):
    global passed, failed
    passed, failed = passed + bool(condition), failed + (not condition)
    print("ok   " if condition else "FAIL ", "slurm:", words, flush=True)


def finish(note=""):
    if note:
        print("      skipped:", note)
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0)


def table(path):
    with h5py.File(path) as f:
        return {k: v[()] for k, v in f["case"].items()}


def same(a, b):
    return a.keys() == b.keys() and all(
        a[k].shape == b[k].shape and (a[k] == b[k]).all() if a[k].dtype.kind != "f"
        else np.array_equal(a[k].view(np.uint64), b[k].view(np.uint64)) for k in a)


def have(*names):
    return all(shutil.which(n) or os.path.exists("/usr/sbin/" + n) for n in names)


def install(*packages):
    if have("slurmctld", "slurmd", "munged", "sbatch", "parallel") or os.geteuid() != 0 or not shutil.which("apt-get"):
        return
    env = dict(os.environ, DEBIAN_FRONTEND="noninteractive")
    subprocess.run(["apt-get", "update", "-qq"], env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    subprocess.run(["apt-get", "install", "-y", "-qq", "--no-install-recommends", *packages], env=env,
                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def wait_for(condition, seconds, between=0.5):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(between)
    return False


def main():
    install("slurm-wlm", "munge", "parallel")
    folder = tempfile.mkdtemp(prefix="castnet_slurm_")
    os.chmod(folder, 0o755)
    for name, text in (("scene.nml", SCENE), ("s.nml", STUDY), ("p.nml", STUDY)):
        with open(os.path.join(folder, name), "w") as f:
            f.write(text)
    r = subprocess.run([CASTNET, "study", "s.nml", "--output", "plain.h5", "--quiet"], cwd=folder, capture_output=True, text=True)
    check(r.returncode == 0, "the study without Slurm " + r.stderr[-200:])
    plain = table(os.path.join(folder, "plain.h5"))
    environment = dict(os.environ, CASTNET=CASTNET)

    if have("parallel"):
        r = subprocess.run([os.path.join(ROOT, "tools", "cluster", "study_parallel.sh"), "p.nml", "3"], cwd=folder,
                           env=environment, capture_output=True, text=True)
        check(r.returncode == 0 and same(plain, table(os.path.join(folder, "p.h5"))), "GNU parallel, same bits " + r.stderr[-300:])
    if os.geteuid() != 0 or not have("slurmctld", "slurmd", "munged", "sbatch"):
        finish("Slurm and munge are not installed, or this is not root")

    host = subprocess.run(["hostname", "-s"], capture_output=True, text=True).stdout.strip()
    for name in ("state", "spool", "log"):
        os.mkdir(os.path.join(folder, name))
    conf = os.path.join(folder, "slurm.conf")
    with open(conf, "w") as f:
        f.write(CONF.format(host=host, dir=folder, cpus=os.cpu_count()))
    environment["SLURM_CONF"] = conf
    if not os.path.exists("/etc/munge/munge.key"):
        subprocess.run(["mungekey", "--create"], stderr=subprocess.DEVNULL)
    subprocess.run(["install", "-d", "-o", "munge", "-g", "munge", "/run/munge"])
    subprocess.run(["su", "-s", "/bin/sh", "munge", "-c", "/usr/sbin/munged --socket=/run/munge/munge.socket.2 --force"],
                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    quiet = dict(stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
    daemons = [subprocess.Popen(["/usr/sbin/slurmctld", "-D"], **quiet)]
    time.sleep(1)
    daemons.append(subprocess.Popen(["/usr/sbin/slurmd", "-D"], **quiet))

    def ask(*words):
        return subprocess.run(words, env=environment, cwd=folder, capture_output=True, text=True)

    try:
        if not wait_for(lambda: "idle" in ask("sinfo", "-h", "-o", "%T").stdout, 60):
            finish("the one-node Slurm did not come up here")
        r = ask("sbatch", "--parsable", "--array=1-3", "--mem-per-cpu=100M", os.path.join(ROOT, "tools", "cluster", "study_array.sbatch"), "s.nml")
        job = r.stdout.strip()
        check(r.returncode == 0 and job.isdigit(), "the array is accepted " + r.stderr[-200:])
        # Stop the first task in its middle, as Slurm does before the time limit: it takes two seconds, a
        # sixth of them up to here.
        journal = os.path.join(folder, "s.h5.shard-1-of-3.cases")
        wait_for(lambda: os.path.exists(journal) and os.path.getsize(journal) > 1500, 120, between=0.05)
        ask("scancel", "--signal=USR1", f"{job}_1")
        requeued = wait_for(lambda: "PENDING" in ask("squeue", "-h", "-r", "-j", f"{job}_1", "-o", "%T").stdout, 60)
        check(requeued, "a task that is told to stop puts itself back into the queue")
        done = wait_for(lambda: ask("squeue", "-h", "-j", job).stdout.strip() == "", 420)
        check(done, "all tasks end")
        r = ask(CASTNET, "collect", "s.nml")
        check(r.returncode == 0 and "missing" not in r.stderr, "collect finds every case " + r.stderr[-200:])
        check(same(plain, table(os.path.join(folder, "s.h5"))), "array with a requeue, same bits")
    finally:
        for d in reversed(daemons):
            d.terminate()
        for d in daemons:
            d.wait()
    shutil.rmtree(folder, ignore_errors=True)
    finish()


main()
