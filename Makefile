# make demo    the whole way on a simulated rig: capture, calibration, training, figures (about 4 minutes on 2 fast cores; STEPS=30000 trains for longer)
# make tools   what tests need beyond Python: a browser, strace and the like; by apt as root, elsewhere it says what to type
# make test    the test suite; of the arm's two clients the one that a test names (`client`), both where they differ (`both_clients`)
# make test-all  the slow tests as well: every fault three times with each client, 20 kills in a row
# make docs    the pages of docs/ as HTML in build/docs
# make lock    refresh constraints/, the versions that make installs
# make install-check  install and use Koala with every Python on this machine
# make package    build wheel and source distribution, compare them with the checkout and start the wheel's commands
# make figures every picture of README.md and docs/, from the code (needs the demonstration; 25 minutes more for the calibration benchmark)
# Everything is installed into .venv; again only when pyproject.toml or setup.py has changed.

SHELL := /bin/bash
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
# a number of steps, not of seconds: a slower machine takes longer and is as good
STEPS ?= 12000
DEMO ?= demo

# $(call step,title,command): show the title and the command, run it, show the time that it took.
define step
@printf '\n== %s\n   %s\n' "$(1)" "$(2)"; start=$$(date +%s); $(2) && printf '   [%d s]\n' $$(($$(date +%s) - start))
endef

.PHONY: demo tools test test-all check fuzz types format docs figures lock install-check package clean
.DEFAULT_GOAL := test

$(READY): pyproject.toml setup.py $(wildcard constraints/*.txt)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "error: $(PYTHON) is older than 3.11; give a newer one: make $(MAKECMDGOALS) PYTHON=python3.12"; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@lock=constraints/$$($(BIN)/python -c 'import sys; print("python%d.%d.txt" % sys.version_info[:2])'); \
	  $(BIN)/python -m pip install --quiet --editable '.[all,test,docs]' $$(test ! -f $$lock || echo --constraint $$lock)
	@touch $@

demo: $(READY)
	@rm -rf demo && mkdir demo && date +%s > demo/started
	$(call step,photograph a calibration board with the simulated arm,$(BIN)/capture run configs/trajectories/calibration_demo.yaml --scene board --out demo/board)
	$(call step,calibrate the camera and its place on the arm,$(BIN)/calib handeye demo/board --out demo/calibration.json)
	$(call step,compare that with the truth of the simulation,$(BIN)/datasets truth demo/board --calibration demo/calibration.json)
	$(call step,photograph a golden head from all around,$(BIN)/capture run configs/trajectories/koala_demo.yaml --scene gold_head --out demo/recording)
	$(call step,make a scene of it,$(BIN)/datasets build demo/recording --calibration demo/calibration.json --out demo/scene)
	$(call step,find the head in its pictures,$(BIN)/datasets mask demo/scene --out demo/koala/gold_head)
	$(call step,train Surf-NeRF,$(BIN)/reconstruct train demo/koala/gold_head --preset fast --set train.steps=$(STEPS) --out demo/run)
	$(call step,measure it on the test views,$(BIN)/reconstruct eval demo/run --stands-on -z)
	$(call step,write the report,$(BIN)/reconstruct report demo/run --calibration demo/calibration.json --out demo/report)
	$(call step,take the surface out of it,$(BIN)/reconstruct mesh demo/run --stands-on -z --out demo/mesh.ply)
	@printf '\n%d s in all; open demo/report/index.html\n' $$(($$(date +%s) - $$(cat demo/started)))

tools:
	tests/install/tools.sh

# small matrices gain nothing from threads, which would keep both workers' cores busy waiting
test test-all: export OPENBLAS_NUM_THREADS = 1

test: $(READY)
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder --durations 40 --durations-min 3

test-all: $(READY)
	$(BIN)/python -m pytest -q -m 'not hardware' --hypothesis-profile thorough

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(MAKE) types
	$(MAKE) test

# 10,000 corrupted inputs (half an hour on 2 cores); faults are listed in build/fuzz/failures.txt
fuzz: $(READY)
	$(BIN)/python tests/fuzz/pool.py 10000
	$(BIN)/python -m pytest -q -m 'slow or not slow' tests/fuzz/test_controller.py

# pyright does not see that the folders are packages of koala3d: it gets a copy in which they are
types: $(READY)
	rm -rf build/types && mkdir -p build/types/koala3d && cp -r capture calib datasets reconstruct configs build/types/koala3d
	set -o pipefail; cd build/types && ../../$(BIN)/pyright --pythonpath ../../$(BIN)/python koala3d | sed 's|build/types/koala3d/||'

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: $(READY)
	$(BIN)/mkdocs build --quiet --strict
	@echo build/docs/index.html

lock: $(READY)
	$(BIN)/python -m pip install --quiet --editable '.[lock]'
	for version in 3.11 3.12 3.13 3.14; do $(BIN)/uv pip compile --quiet --universal --no-header --no-annotate --upgrade \
	  --python-version $$version --extra all --extra test --extra docs --output-file constraints/python$$version.txt pyproject.toml || exit 1; done

package: $(READY)
	$(BIN)/python -m pip install --quiet --editable '.[lock]'
	$(BIN)/python tests/install/package.py

install-check:
	$(PYTHON) tests/install/check.py $(VERSIONS)

figures: $(DEMO)/report/strip.png build/calibration_bench
	$(BIN)/python docs/make_figures.py $(DEMO) docs/pictures
	cp build/calibration_bench/bench.png docs/pictures/calibration_bench.png

demo/report/strip.png:
	$(MAKE) demo

build/calibration_bench: $(READY)
	$(BIN)/python -m tests.bench.handeye --out $@

clean:
	rm -rf demo build .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +
