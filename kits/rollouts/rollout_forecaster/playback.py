"""A rehearsal's recording, played open-loop in many imagined worlds at once, each judged by the contract at its end.

The raw states become snapshots by the code that also makes the observation of a real session. The recording is not
corrected on the way: a leaf that would have measured a held object anew does not, so a chance is estimated rather too
low than too high. Until the robot first comes near an object, worlds differ only in where objects are, and a world is
composed of the recorded robot and the drawn objects.

Enough rollouts have been seen when Wald's sequential probability ratio test on their successes says so ("Sequential
Tests of Statistical Hypotheses", 1945, doi:10.1214/aoms/1177731118). Two chances are distinguished, one below the
threshold and one above it; in between the share decides when the requested rollouts are used up. Clear cases take a
few.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
from mujoco import rollout

from phyagentos.protocol.predicates.builtins import MOVED_M
from phyagentos.protocol.predicates.evaluation import evaluate
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import make_call
from phyagentos.protocol.predicates.predicate import View, has_metric, iter_entities, parse_predicate
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.execution.holds import HoldMonitor
from rollout_forecaster.estimate import SETTLE_S, Array
from rollout_forecaster.rehearsal import STATE_STEPS, Rehearsal, Stage
from rollout_forecaster.uncertainty import ImaginedStart

SAMPLE_S = 0.1  # conditions are sampled as in a real session, at 10 Hz of simulated time
_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
NEAR_M = 0.03  # more than what a pose is wrong by, at three standard deviations of an object that is seen badly
ERROR = 0.1  # chance of stopping on the wrong side at most, of each kind; whole rollouts make it less
BELOW, ABOVE = 0.2, 0.1  # how far from the threshold the two chances lie at most
TINY = 1e-6  # keeps logarithms finite


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollout:
    """Samples of one imagined world: what was held, and the world after its objects had come to rest and at the end.

    `violated` is the first condition that did not hold all through; empty when all did.
    """

    held: tuple[tuple[str, ...], ...]
    initial: Environment
    terminal: Environment
    violated: str = ""


class Playback:
    """One recording, for any number of worlds; the number of threads changes no bit of the result.

    `nominal` is the rehearsal itself, sampled as every world is.
    """

    def __init__(self, rehearsal: Rehearsal, threads: int = 1) -> None:
        self._rehearsal = rehearsal
        model = rehearsal.stage.physics.model
        rest_steps, stride = (round(span_s / model.opt.timestep) for span_s in (SETTLE_S, SAMPLE_S))
        self._head = SharedPrefix(rehearsal, rest_steps)
        self._controls = rehearsal.controls[self._head.steps :]
        if not self._head.steps:  # the robot waits until the objects have come to rest
            self._controls = np.concatenate((np.repeat(rehearsal.controls[:1], rest_steps, axis=0), self._controls))
        last = len(self._controls) - 1
        self._chosen = [*range(rest_steps - 1, last, stride), last]
        self._data = [mujoco.MjData(model) for _ in range(max(1, threads))]
        self.nominal = _watch(self._read_nominal(rest_steps), rehearsal, rehearsal.stage)

    def _read_nominal(self, rest_steps: int) -> Array:
        """(n, n_state) states of the rehearsal itself, at the sampled moments of every world."""
        states, first = self._rehearsal.states, self._head.steps or -rest_steps
        moments = [round((first + index + 1) / STATE_STEPS) for index in self._chosen]
        return states[[min(moment, len(states) - 1) for moment in moments]]

    def play(self, starts: Sequence[ImaginedStart]) -> list[Rollout]:
        """The rollout of every one of these worlds."""
        begins = np.array([self._head.put(start.state) for start in starts])
        models = [start.model for start in starts]
        states, _ = rollout.rollout(models, self._data, begins, self._controls[None])
        return [_watch(each[self._chosen], self._rehearsal, self._rehearsal.stage) for each in states]


def _watch(states: Array, rehearsal: Rehearsal, stage: Stage) -> Rollout:
    """One world's samples, as a session's observers would have seen them."""
    session, physics = rehearsal.session, stage.physics
    held: list[tuple[str, ...]] = []
    violated = ""
    initial = terminal = _look(states[0], stage)
    holds = HoldMonitor(session.hold, initial, session.target)
    for state in states[1:]:
        if session.hold and not violated:
            terminal = _look(state, stage)
            criterion = holds.sample(terminal)
            violated = criterion.text if criterion is not None else ""
            held.append(terminal.targets[session.target].holding)
        else:
            _enter(state, physics)
            physics.queries.look()
            held.append(physics.queries.read_target(physics.queries.find_touching()).holding)
    return Rollout(held=tuple(held), initial=initial, terminal=_look(states[-1], stage), violated=violated)


def _look(state: Array, stage: Stage) -> Environment:
    _enter(state, stage.physics)
    return stage.observe()


def _enter(state: Array, physics: Physics) -> None:
    mujoco.mj_setState(physics.model, physics.data, state, _FULL)
    mujoco.mj_fwdPosition(physics.model, physics.data)  # its contacts, which a state does not hold


def find_cause(rollout: Rollout, nominal: Rollout, rehearsal: Rehearsal) -> str:
    """Coded cause why a world's end does not meet the contract; empty when it does.

    A grasp is judged by comparison with the nominal rollout: where that held the object, this world should.
    """
    session = rehearsal.session
    view = View(now=rollout.terminal, initial=rollout.initial, target=session.target)
    foreseeable = [text for text in session.accept if not has_metric(text)]  # nothing is measured on the way here
    failed = [text for text in foreseeable if parse_predicate(text).evaluate(view).truth is not Truth.TRUE]
    if rollout.violated:
        return "CONSTRAINT_VIOLATED"
    if not failed:
        return ""
    if cause := _judge_grasp(rollout, nominal):
        return cause
    item = session.find_object(rollout.initial)
    about = {name for text in failed for name in iter_entities(parse_predicate(text))}
    if any(_has_moved(name, rollout) and not _has_moved(name, nominal) for name in about - {item}):
        return "OBJECT_MOVED"  # what was to stay where it was
    if any(_has_been_on(name, item, rollout) for name in about - {item}):
        return "LOAD_LOST"  # what was to travel with the object
    return "PLACED_WRONG" if any(_has_moved(name, rollout) for name in {item, *about}) else "WITHOUT_EFFECT"


def _judge_grasp(rollout: Rollout, nominal: Rollout) -> str:
    missing = [set(wanted) - set(found) for wanted, found in zip(nominal.held, rollout.held, strict=True)]
    lost = set.union(*(first & second for first, second in pairwise(missing)), set())
    if not lost:  # a single sample without contact is a flicker
        return ""
    return "GRASP_LOST" if any(lost & set(found) for found in rollout.held) else "GRASP_MISSED"


def _has_been_on(load: str, item: object, rollout: Rollout) -> bool:
    if item not in rollout.initial.entities or load not in rollout.initial.entities:
        return False
    view = View(now=rollout.initial, initial=rollout.initial, target=None)
    return evaluate(make_call(Meaning.ON, load, str(item)), view).truth is Truth.TRUE


def _has_moved(name: object, rollout: Rollout) -> bool:
    before, after = (world.entities.get(str(name)) for world in (rollout.initial, rollout.terminal))
    if before is None or after is None:
        return False
    return float(np.linalg.norm(np.subtract(after.pose.position_m, before.pose.position_m))) > MOVED_M


class SharedPrefix:
    """The beginning that all worlds of a recording share: `steps` physics steps that need not be played.

    Drawn objects take `settle_steps` to come to rest, before anything is near them. With conditions that must hold all
    through, nothing is left out.
    """

    def __init__(self, rehearsal: Rehearsal, settle_steps: int) -> None:
        self._model = rehearsal.stage.physics.model
        self._bodies = [self._model.body(entity.name).id for entity in rehearsal.stage.physics.scene.entities]
        index = 0 if rehearsal.session.hold else self._find_near(rehearsal.states) - -(-settle_steps // STATE_STEPS)
        self.steps = max(0, index) * STATE_STEPS
        self._state = rehearsal.states[index] if index > 0 else None
        joints = np.flatnonzero(np.isin(self._model.jnt_bodyid, self._bodies))
        self._joints: list[int] = joints.tolist()

    def put(self, state: Array) -> Array:
        """The mjSTATE_FULLPHYSICS of a world after the head start, from that at its beginning."""
        if self._state is None:
            return state
        model = self._model
        drawn, ahead = mujoco.MjData(model), mujoco.MjData(model)
        mujoco.mj_setState(model, drawn, state, _FULL)
        mujoco.mj_setState(model, ahead, self._state, _FULL)
        for joint in self._joints:
            q, v = _find_places(model, joint)
            ahead.qpos[q], ahead.qvel[v] = drawn.qpos[q], drawn.qvel[v]
        put = np.zeros_like(state)
        mujoco.mj_getState(model, ahead, put, _FULL)
        return put

    def _find_near(self, states: Array) -> int:
        """Index of the first state in which the robot is near an object; that of the last one when none is."""
        model = copy.copy(self._model)
        of_objects = np.isin(model.geom_bodyid, self._bodies)
        model.geom_margin[of_objects] += NEAR_M
        data = mujoco.MjData(model)
        for index, state in enumerate(states):
            mujoco.mj_setState(model, data, state, _FULL)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            is_object = of_objects[data.contact.geom[: data.ncon]]
            if (is_object[:, 0] != is_object[:, 1]).any():
                return index
        return len(states) - 1


def _find_places(model: mujoco.MjModel, joint: int) -> tuple[slice, slice]:
    """Where the position and the velocity of a joint are."""
    q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    is_free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    return slice(q, q + (7 if is_free else 1)), slice(v, v + (6 if is_free else 1))


def is_decided(successes: int, trials: int, threshold: float, most: int) -> bool:
    """Whether more rollouts would hardly change on which side of the threshold (0..1) a chance is.

    There was at least one trial; after `most` of them it is decided in any case.
    """
    is_enough = successes >= threshold * trials
    left = most - trials
    if left <= 0 or successes >= threshold * most or successes + left < threshold * most:
        return True
    room = min(1.0, threshold / BELOW, (1.0 - threshold) / (2.0 * ABOVE))  # near 0 and 1 the two chances draw together
    low, high = threshold - room * BELOW, threshold + room * ABOVE
    ratio = successes * _log_ratio(high, low) + (trials - successes) * _log_ratio(1.0 - high, 1.0 - low)
    bound = math.log((1.0 - ERROR) / ERROR)
    return ratio >= bound if is_enough else ratio <= -bound


def _log_ratio(above: float, below: float) -> float:
    return math.log(max(above, TINY) / max(below, TINY))
