"""A run in a process of its own, for tests that kill it: study, store, workers, trials."""

import sys
from pathlib import Path

from lensdesign import TransferLensError
from lensdesign.common.console import fail
from tolerancing.run.run import run_study
from tolerancing.study.files import load_study

if __name__ == "__main__":
    study, store, workers, trials = sys.argv[1:]
    try:
        run_study(
            load_study(Path(study)),
            store,
            workers=int(workers),
            trials=int(trials),
            progress=lambda done, total: print(done, flush=True),
        )
    except TransferLensError as error:
        fail(str(error))
