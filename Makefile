# make demo: the main job on the paper's lens.  make check: style, types and quick tests, for every change.
# make test: style, types and all tests.  make docs: the documentation.
# make paper: the paper's equations, tables, figures and numbers on one page.
# All set up their own virtual environment first; Python 3.11, make and a C compiler are enough.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
READY := .venv/ready
OUT := demo_output
PACKAGES := lensdesign wavesim tolerancing studio

.PHONY: demo gallery paper check test style types tests quick-tests slow-tests commands test-lowest docs benchmarks lock clean

demo: $(READY)
	@mkdir -p $(OUT)
	@date +%s > $(OUT)/.started
	@# Exit status 1 says that a constraint is not met: the paper's lens is 0.9 % over its spread limit.
	$(BIN)/lensdesign check designs/paper_singlet.toml || test $$? -eq 1
	$(BIN)/lensdesign optimize designs/feasible_singlet_spec.toml -o $(OUT)/feasible_singlet.toml
	$(BIN)/lensdesign check $(OUT)/feasible_singlet.toml
	$(BIN)/lensdesign draw designs/paper_singlet.toml -o $(OUT)/paper_singlet
	$(BIN)/lensdesign draw $(OUT)/feasible_singlet.toml -o $(OUT)/feasible_singlet
	$(BIN)/lensdesign export designs/paper_singlet.toml $(OUT)/paper_singlet/paper_singlet.stl
	$(BIN)/lensdesign export $(OUT)/feasible_singlet.toml $(OUT)/feasible_singlet/feasible_singlet.stl
	$(BIN)/wavesim pupil designs/paper_singlet.toml --decenter-y-mm 0.03 -o $(OUT)/paper_singlet/decentered_30um.png
	$(BIN)/wavesim resolve-lines designs/paper_singlet.toml --field-heights-mm 0,1.4 --slices 200 --compensation vertical \
	  --linewidths-um 1.55,0.775,0.532
	$(BIN)/wavesim resolve-lines designs/paper_singlet.toml --field-heights-mm 0,1.4 --slices 30 --compensation oblique \
	  --linewidths-um 1.55,0.775,0.532
	$(BIN)/lensdesign scale designs/paper_singlet.toml 0.0625 -o $(OUT)/twin.toml
	$(BIN)/wavesim image $(OUT)/twin.toml --object usaf --patch-mm 0.19 -o $(OUT)/frames
	$(BIN)/wavesim reconstruct $(OUT)/frames/frame_1.tif $(OUT)/frames/frame_2.tif --design $(OUT)/twin.toml \
	  --patch-mm 0.19 --kind amplitude --truth $(OUT)/frames --usaf bright -o $(OUT)/object
	$(BIN)/tolerancing run designs/paper_tolerances.toml --store $(OUT)/paper_tolerances.db --fresh
	$(BIN)/tolerancing report $(OUT)/paper_tolerances.db -o $(OUT)/report
	@echo
	@echo "Everything lies in $(OUT):"
	@echo "  feasible_singlet.toml       the strictly feasible sibling, as a design file"
	@echo "  paper_singlet/              layout, spots, arrival angles, 3D view, mesh, effect of a decentration"
	@echo "  feasible_singlet/           the same of the sibling"
	@echo "  frames/, object/            two noisy frames of a chart through a small twin; the chart found in them, beside the true one"
	@echo "  paper_tolerances.db         the tolerance study's trials and sweeps"
	@echo "  report/report.html          its report; open it in a browser"
	@seconds=$$(( $$(date +%s) - $$(cat $(OUT)/.started) )); rm $(OUT)/.started; \
	  echo "It took $$(( seconds / 60 )) min $$(( seconds % 60 )) s."

# The lenses of docs/gallery.md from their specifications, with pictures, meshes and drawings: two minutes.
GALLERY := feasible_singlet thinnest_singlet moulded_pair wide_field phone_lens q_type_lens stock_pair rectangular_sensor \
  single_complex single_phase

gallery: $(READY)
	@mkdir -p $(OUT)/gallery
	cp designs/paper_singlet.toml $(OUT)/gallery/
	@set -e; for lens in $(GALLERY); do \
	  $(BIN)/lensdesign optimize designs/$${lens}_spec.toml -o $(OUT)/gallery/$$lens.toml; \
	  $(BIN)/lensdesign check $(OUT)/gallery/$$lens.toml; \
	done
	@set -e; for lens in paper_singlet $(GALLERY); do \
	  $(BIN)/lensdesign draw $(OUT)/gallery/$$lens.toml -o $(OUT)/gallery/$$lens --format svg; \
	  $(BIN)/lensdesign export $(OUT)/gallery/$$lens.toml $(OUT)/gallery/$$lens/$$lens.stl; \
	done
	@set -e; for lens in paper_singlet $(GALLERY); do \
	  $(BIN)/lensdesign drawing $(OUT)/gallery/$$lens.toml -o $(OUT)/gallery/$$lens/drawing.pdf; \
	done

# The paper beside this toolkit, on small twins of the lens; python -m paper takes the lens itself, and hours.
paper: $(READY)
	$(BIN)/python -m paper --quick -o paper_output
	@echo "read paper_output/paper.md"

# Unit tests alone: without whole commands, browser, cluster, notebooks, site and pages, which take long.
check: style
	$(MAKE) --no-print-directory --jobs=2 types quick-tests

test: style
	$(MAKE) --no-print-directory --jobs=2 types tests

style: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/mypy $(PACKAGES)

# The functions of a file go to one worker, which makes what they share once, and so do those of a class. Python keeps
# what it compiles, whatever the environment says: workers and the processes that tests start need it again.
PYTEST = PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 \
  $(BIN)/python -m pytest -n auto --dist loadscope --no-loadscope-reorder

tests: $(READY)
	$(PYTEST)

quick-tests: $(READY)
	$(PYTEST) -m "not slow"

# The list of tests that `make check` leaves out, from the times of all tests on this machine. What a slow test
# computes serves others, which are slow without it: they are added.
slow-tests: $(READY)
	RECORD_SLOW_TESTS=all $(PYTEST)
	RECORD_SLOW_TESTS=more $(PYTEST) -m "not slow"
	RECORD_SLOW_TESTS=more $(PYTEST) -m "not slow"

# Every command of the documentation; `make tests` leaves out those that take about half a minute or more.
commands: $(READY)
	DOCUMENTED_COMMANDS=all $(BIN)/python -m pytest tests/test_documented_commands.py

$(READY): requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or later is needed: make PYTHON=..."'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --requirement requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps --editable .
	touch $@

# The oldest versions that pyproject.toml allows.
test-lowest: $(READY)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv venv --quiet --clear .venv-lowest
	$(BIN)/uv pip install --quiet --python .venv-lowest --resolution lowest-direct --editable '.[dev]'
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 \
	  .venv-lowest/bin/python -m pytest -n auto --dist loadscope --no-loadscope-reorder

docs: $(READY)
	$(BIN)/sphinx-build --builder html --conf-dir docs --doctree-dir build/doctrees --fail-on-warning --quiet . site
	@echo "open site/index.html in a browser"

benchmarks: $(READY)
	$(BIN)/python -m benchmarks

lock: $(READY)
	$(BIN)/python -m pip install --quiet uv
	printf 'hatchling\neditables\n' | $(BIN)/uv pip compile --quiet --universal --python-version 3.11 \
	  --extra dev --generate-hashes --no-annotate --no-header --no-emit-index-url --no-emit-find-links \
	  --upgrade pyproject.toml - --output-file requirements.lock
	sed -i '1i # Every version that make installs, and its files by their hashes: the package, its dev extra and its build requirements.\n# To renew it: make lock' requirements.lock

clean:
	rm -rf .venv .venv-lowest demo_output paper_output site jupyter_execute build dist
