# The environment lives in .venv and is rebuilt when pyproject.toml, constraints.txt or the C++ core changes.
PYTHON ?= python3
PYTEST_ARGS ?=
TRAIN_ARGS ?=

BIN := .venv/bin
CORE := $(wildcard $(addprefix capsule_gym/core/,CMakeLists.txt backend.py stub.py *.hpp */*.?pp */*.h))
STAMP := .venv/.installed

# Without its bytecode on disk every process that imports torch compiles it anew, for five seconds.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help train test distil examples notebooks coverage venv lint types docs web leaderboard leaderboard-check reproduce regression fuzz fuzz-core bits bits-check arm64 sanitize core-coverage install-check oldest check clean

help:  ## List the targets
	@grep -hE '^[a-z0-9-]+:.*  ## ' $(MAKEFILE_LIST) | sed -E 's/:.*  ## /\t/' | awk -F '\t' '{printf "%-18s %s\n", $$1, $$2}'

train: $(STAMP)  ## Install everything and train the default agent (TRAIN_ARGS="--help" for more)
	$(BIN)/python train.py $(TRAIN_ARGS)

# A worker that has no tests left takes those at the end of the other's: neighbours share fixtures. Each keeps to one
# core, or torch's threads would wait for one another.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal
test: $(STAMP)  ## Install everything and run the tests (PYTEST_ARGS="tests/web -x" for some)
	$(PYTEST) $(PYTEST_ARGS)

distil: STUDENT ?= dp-distilled
distil: SEED ?= 100
distil: SET ?= real-wide
distil: $(STAMP)  ## Install everything, distil the optimum into a policy and compare it with the published ones
	$(BIN)/python -m agents.distillation $(STUDENT) --seeds $(SEED) $(if $(RIG),--rig $(RIG))
	$(if $(RIG),,$(BIN)/python -m agents.evaluate runs/distillation/$(STUDENT)/seed-$(SEED) --set $(SET) --against $(STUDENT))

# Those whose library is missing are skipped: each has an extra of its own, and they do not all go together.
examples: export EXAMPLES = 1
examples: $(STAMP)  ## Run the examples of the installed libraries (EXTRA=torchrl installs one)
	$(if $(EXTRA),$(BIN)/python -m pip install --disable-pip-version-check -e ".[$(EXTRA)]" -c examples/constraints.txt)
	$(BIN)/python -m pytest tests/examples $(PYTEST_ARGS)

notebooks: $(STAMP)  ## Execute the notebooks and save their output
	$(BIN)/python -m pip install --disable-pip-version-check -e ".[notebooks]" -c constraints.txt
	$(BIN)/jupyter nbconvert --to notebook --execute --inplace --ExecutePreprocessor.record_timing=False notebooks/*.ipynb

# Slow before Python 3.14, whose monitoring sees branches. The minimum is in pyproject.toml.
coverage: $(STAMP)  ## Run the tests and fail below the minimum coverage
	COVERAGE_CORE=$$($(BIN)/python -c "import sys; print('sysmon' if sys.version_info >= (3, 14) else 'ctrace')") \
		$(PYTEST) --cov $(PYTEST_ARGS)

venv: $(STAMP)  ## Create .venv with the pinned versions (PYTHON=python3.12 chooses the interpreter)

# uv takes a quarter of pip's time, but does not read pip's settings; where it fails, pip installs.
pip_setting = $$($(1)/bin/python -m pip config list | sed -n "s/.*[.]$(2)='\(.*\)'$$/\1/p" | head -n 1)

# $(1): folder of the environment, $(2): options of the core's compilation
define install_editable
	$(PYTHON) -m venv $(1)
	$(1)/bin/python -m pip install --disable-pip-version-check uv -c constraints.txt
	UV_FIND_LINKS="$(call pip_setting,$(1),find-links)" UV_DEFAULT_INDEX="$(call pip_setting,$(1),index-url)" \
		$(1)/bin/uv pip install --system-certs --python $(1)/bin/python -e ".[dev]" -c constraints.txt \
		--build-constraints constraints.txt $(2) || \
		$(1)/bin/python -m pip install --disable-pip-version-check -e ".[dev]" -c constraints.txt $(2)
endef

$(STAMP): pyproject.toml constraints.txt $(CORE)
	$(call install_editable,.venv)
	touch $@

# clang-format formats C, C++ and JavaScript.
FORMATTED = $$(git ls-files '*.cpp' '*.hpp' '*.c' '*.h' '*.js' '*.mjs' ':!docs/katex')
lint: $(STAMP)  ## Check style, formatting and import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror $(FORMATTED)
	$(BIN)/lint-imports --no-cache --no-logo

types: $(STAMP)  ## Check types
	$(BIN)/mypy

# mkdocs empties the folder first.
docs: $(STAMP)  ## Build the documentation into site/, with the live module in it
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	$(BIN)/python -m web.build

web: $(STAMP)  ## Build the environment for browsers and node into site/live/ alone
	$(BIN)/python -m web.build

leaderboard: $(STAMP)  ## Evaluate all policies and write the leaderboard and its analysis
	$(BIN)/python -m agents.leaderboard
	$(BIN)/python -m agents.analysis limit_cycle curves

leaderboard-check: $(STAMP)  ## Fail if the leaderboard or its analysis is stale (PLANTS=25 evaluates 25 plants per set)
	$(BIN)/python -m agents.leaderboard --check $(if $(PLANTS),--plants $(PLANTS))
	$(BIN)/python -m agents.analysis limit_cycle curves --check

reproduce: ROWS ?= direct-ppo direct-ppo-wide residual-ppo efficient
reproduce: SEED ?= 100
reproduce: $(STAMP)  ## Train one run of each row and compare it with the published ones (ten minutes)
	$(BIN)/python -m agents.study $(ROWS) --seeds $(SEED) --runs runs/reproduce
	$(foreach row,$(ROWS),$(BIN)/python -m agents.evaluate runs/reproduce/$(row)/seed-$(SEED) --against $(row) &&) true

regression: $(STAMP)  ## Fail if a ratio of speeds is below its floor
	$(BIN)/python -m benchmarks.throughput

FUZZ := tests/capsule_gym/test_arguments.py tests/capsule_gym/policies/test_fuzz.py tests/project/test_files.py
fuzz: $(STAMP)  ## Try random arguments of the environments and random files; fail on an unexpected error
	$(BIN)/python -m pytest -n 2 --hypothesis-profile fuzz $(FUZZ)

# Guided by coverage: clang's libFuzzer. What fails, and what has been reached, stays in runs/fuzz.
FUZZED := runs/fuzz
FUZZ_FLAGS := -g1 -O1 -march=native -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all -I$(FUZZED)
fuzz-core: FUZZ_SECONDS ?= 40
fuzz-core: $(STAMP)  ## Fuzz the core, its functions and exported C, each for FUZZ_SECONDS (40)
	mkdir -p $(FUZZED)
	$(BIN)/python -m capsule_gym.export residual-real --law --c $(FUZZED)/law.h --overwrite
	$(BIN)/python -m capsule_gym.export direct-recurrent-ppo --c $(FUZZED)/recurrent.h --overwrite
	clang -std=c99 $(FUZZ_FLAGS) tests/fuzz/exported.c -o $(FUZZED)/exported -lm
	for name in functions step; do clang++ -std=c++20 $(FUZZ_FLAGS) -DLEVEL=fuzz -DCAPSULE_INSTRUMENTED \
		-DCAPSULE_FP_CONTRACT_OFF -ffp-contract=off -Wno-psabi tests/fuzz/$$name.cpp -o $(FUZZED)/$$name || exit 1; done
	for name in exported functions step; do mkdir -p $(FUZZED)/$$name.reached && $(FUZZED)/$$name \
		$(FUZZED)/$$name.reached -max_total_time=$(FUZZ_SECONDS) -max_len=1500 -len_control=0 \
		-artifact_prefix=$(FUZZED)/$$name- || exit 1; done

bits-check: $(STAMP)  ## Compare whole episodes with the committed hashes, one seed of each trained policy
	$(BIN)/python -m tests.bits --first-seeds

# At each level of instructions; then without the vectors of NumPy and of the C library, which unknown names do not disturb.
bits: VECTORS := import numpy; print(*numpy.show_config(mode='dicts')['SIMD Extensions'].get('found', []))
bits: $(STAMP)  ## The same for all seeds, as other processors compute, and for the live page
	for level in $$($(BIN)/python -c "from capsule_gym.core import _core; print(*_core.LEVELS)"); do \
		CAPSULE_GYM_LEVEL=$$level $(BIN)/python -m tests.bits || exit 1; done
	NPY_DISABLE_CPU_FEATURES="$$($(BIN)/python -c "$(VECTORS)")" \
		GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX2_Usable,-FMA_Usable,-FMA4_Usable,-AVX512F_Usable \
		$(BIN)/python -m tests.bits
	$(BIN)/python -m web.episodes

# All first seeds take twenty minutes.
arm64: SUBJECTS ?= --first-seeds
arm64: $(STAMP)  ## Compare the hashes on an emulated arm64 (SUBJECTS="plant 'law pd'" compares some)
	.ci/arm64 $(SUBJECTS)

# In environments of their own, whose core is compiled otherwise. Python does not free everything at its end. The library
# of C++ must be there from the start, or the first exception in any module ends Python.
sanitize: SANITIZED := runs/sanitize
sanitize:  ## Run the environment's tests with a core that checks addresses and undefined behaviour
	$(call install_editable,$(SANITIZED),-C cmake.define.SANITIZE=ON)
	LD_PRELOAD="$$($(CXX) -print-file-name=libasan.so) $$($(CXX) -print-file-name=libstdc++.so)" \
		ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 PYTHONMALLOC=malloc \
		$(SANITIZED)/bin/python -m pytest tests/capsule_gym $(PYTEST_ARGS)

# gcovr takes more than 2^32 executions of a line for a fault, unless the threshold is 0.
core-coverage: COUNTED := runs/core-coverage
core-coverage:  ## Run the environment's tests and fail below the minimum coverage of the C++ core
	$(call install_editable,$(COUNTED),-C cmake.define.COVERAGE=ON -C build-dir=$(COUNTED)/build)
	find $(COUNTED)/build -name "*.gcda" -delete
	$(COUNTED)/bin/python -m pytest tests/capsule_gym $(PYTEST_ARGS)
	$(COUNTED)/bin/gcovr --merge-lines --gcov-suspicious-hits-threshold 0 --filter capsule_gym/core/ \
		--exclude-throw-branches --fail-under-line 97 --fail-under-branch 87 $(COUNTED)/build

install-check:  ## Install as the README does in an empty environment without a compiler, and run it
	PYTHON="$(PYTHON)" .ci/install

# The oldest matplotlib calls names that pyparsing 3.3 deprecates.
oldest: OLDEST := runs/oldest/bin
oldest:  ## Run the environment's tests with the oldest supported versions
	$(PYTHON) -m venv runs/oldest
	$(OLDEST)/python -m pip install --disable-pip-version-check uv
	$(OLDEST)/uv pip install --python $(OLDEST)/python --resolution lowest-direct -e ".[sb3,law,identify,export,bench]" \
		"hypothesis>=6.100" "mpmath>=1.3" "pyparsing>=3.1,<3.3" "pytest>=8.2" "scipy>=1.11"
	$(OLDEST)/python -m pytest tests/capsule_gym

check: lint types docs leaderboard-check regression fuzz bits  ## All checks but the tests

clean:  ## Remove caches and build outputs; keeps .venv and runs/
	rm -rf build dist site .hypothesis .pytest_cache .ruff_cache .mypy_cache .coverage*
	find . -path ./.venv -prune -o -type d -name __pycache__ -exec rm -rf {} +
