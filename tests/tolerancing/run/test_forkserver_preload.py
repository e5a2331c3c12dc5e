"""What copies of the server have ready: all that trials by rays and pupils need."""

import json
import subprocess
import sys

NEEDED = """
import gc, json, sys
import tolerancing.run.forkserver_preload
from lensdesign.raytrace.kernel import trace_kernel
from tolerancing.study.evaluate import context_of, score_trials
from tolerancing.study.files import load_study

loaded = load_study(sys.argv[1])
context = context_of(loaded.lens, loaded.study)
before, kernels = set(sys.modules), len(trace_kernel.signatures)
score_trials(context, loaded.study, (0, 1))
more = sorted(name for name in set(sys.modules) - before if not name.startswith("encodings."))
print(json.dumps([more, len(trace_kernel.signatures) - kernels, gc.isenabled(), gc.get_freeze_count() > 0]))
"""


def test_trials_import_and_load_nothing_more(write_study, full_study):
    path = write_study(full_study)
    done = subprocess.run([sys.executable, "-c", NEEDED, path], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [[], 0, True, True]
