"""A Dask cluster of processes on this machine."""

import json
import os
import subprocess
import sys
import time


class Cluster:
    """A scheduler and its workers, processes of their own on this machine."""

    def __init__(self, folder):
        self.folder, self.processes = folder, []
        file = folder / "scheduler.json"
        self.start("dask_scheduler", "--port", "0", "--scheduler-file", str(file))
        while not file.exists() or not file.read_text().endswith("}"):  # it appears before it is written
            assert self.processes[0].poll() is None, (folder / "log").read_text()
            time.sleep(0.02)
        self.address = json.loads(file.read_text())["address"]

    def start(self, module_name, *options):
        command = [sys.executable, "-m", f"distributed.cli.{module_name}", *options]
        with (self.folder / "log").open("a") as log:
            process = subprocess.Popen(
                [*command, "--host", "127.0.0.1", "--no-dashboard"], stdout=log, stderr=log, cwd=os.getcwd()
            )
        self.processes.append(process)
        return process

    def worker(self):
        place = self.folder / f"worker{len(self.processes)}"
        return self.start(
            "dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--local-directory", str(place)
        )

    def close(self):
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.wait()
