# Two commands: `make run` shows the whole chain on the sample recording, `make test` passes the tests.
# Both set up what they need, once.
PYTHON ?= python3
JOBS ?= 2
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt
# A torch without CUDA, where pip's index offers one; on Linux the usual one brings 2.5 GB of CUDA to download.
TORCH_FOR_CPU := torch==$(shell sed -n 's/^torch==//p' constraints.txt)+cpu
READY := $(VENV)/.ready
SAMPLE := sample_data/recordings/first_touch.h5

.PHONY: run test setup lint slow gpu monkey tour docs stability bench samples clean

run: $(READY)
	@if [ -n "$$DISPLAY$$WAYLAND_DISPLAY" ]; then \
		$(BIN)/tactoscope view $(SAMPLE) --target soft_bubble --sensor gelslim; \
	else \
		xvfb-run -a -s "-screen 0 1600x950x24" \
			$(BIN)/tactoscope view $(SAMPLE) --target soft_bubble --sensor gelslim --tour out; \
	fi

# Two processes, a file's tests in one of them; each adds on one thread, so that they do not get in each other's way.
test: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -m "not slow and not gpu" -n $(JOBS) --dist loadfile --max-worker-restart 0

setup: $(READY)

$(READY): pyproject.toml constraints.txt scripts/system-packages.sh
	@PYTHON=$(PYTHON) WITHOUT_SYSTEM_PACKAGES=$(WITHOUT_SYSTEM_PACKAGES) scripts/system-packages.sh
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed (3.11 to 3.13 were tried); give it with 'make PYTHON=/path/to/python3.11'" >&2; exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@echo "installing Python packages into $(VENV) (1.1 GB to download, 4.0 GB on disk, once)"
	@$(PIP) $(TORCH_FOR_CPU) 2>/dev/null || \
		{ echo "pip's index has no $(TORCH_FOR_CPU); taking the usual one (2.5 GB more to download on Linux; PIP_EXTRA_INDEX_URL can name PyTorch's index for the processor)"; $(PIP) torch; }
	@$(PIP) -e '.[dev]'
	@$(BIN)/tactoscope prepare
	@touch $@

lint: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright
	$(BIN)/lint-imports

slow: $(READY)
	$(BIN)/python -m pytest -q -m slow

# The tests that need a graphics card, and the times of a lab-sized network on it.
gpu: $(READY)
	$(BIN)/python -m pytest -q -m gpu
	$(BIN)/python -m benchmarks.gpu

# A seeded monkey over commands, controls and files for an hour; MONKEY_MINUTES says otherwise.
MONKEY_MINUTES ?= 60
monkey: $(READY)
	MONKEY_MINUTES=$(MONKEY_MINUTES) xvfb-run -a -s "-screen 0 1920x1200x24" $(BIN)/python -m pytest -q --no-xvfb tests/app/window/test_random_input.py -s \
		--timeout 14400 -o faulthandler_timeout=0

# The pictures and the film of README.md and docs/tour.md, as the program is now.
tour: $(READY)
	$(BIN)/tactoscope export $(SAMPLE) --sensor gelslim --target soft_bubble --pane scene --frames 4-10 --size 560 420 --out docs/press.webp
	xvfb-run -a -s "-screen 0 1600x950x24" $(BIN)/python docs/make_tour.py

# The pages of docs/ with the API from its docstrings, in out/site; a link that leads nowhere fails.
docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Up to 10,000 cases a row, fewer where one is slow; the table with their numbers is left in out/stability.json.
stability: $(READY)
	$(BIN)/python -m pytest -q tests/stability --cases 10000 -m "not slow" \
		--timeout 14400 -o faulthandler_timeout=0

bench: $(READY)
	$(BIN)/tactoscope bench --json out/bench.json --plots out/plots

samples: $(READY)
	$(BIN)/python -m sample_data.make_samples

clean:
	rm -rf out build .pytest_cache .ruff_cache .hypothesis
