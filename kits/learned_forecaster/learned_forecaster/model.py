"""The learned model: Bayesian logistic regression of success, and the shares of causes among the failures of a skill.

Weights have a normal prior; the posterior is Laplace's approximation, and forecasts are its moderated output (D. J. C.
MacKay, "The Evidence Framework Applied to Classification Networks" (1992), doi:10.1162/neco.1992.4.5.720). The variance
of a forecast is that of a Beta distribution, whose counts say how many cases the model is worth there. The file is JSON
of numbers and names; nothing in it is executed.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.sessions.calibration import Scored, TrackRecord, compute_record
from phyagentos.protocol.sessions.lookahead import Outcomes
from phyagentos.protocol.sessions.verdicts import CAUSE_UNKNOWN

PRECISION = 4.0  # of the prior of a weight: half a unit of log odds for a standard deviation of its feature
FOLDS = 5
FEATURES_MAX = 500
Array = NDArray[np.float64]


class Example(NamedTuple):
    """One session: its features, and how it ended; an empty cause is a success."""

    features: Mapping[str, float]
    skill: str
    cause: str


class Feature(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One input: (value - mean) / scale, 0 where it is absent, times its weight."""

    name: str
    mean: float
    scale: Annotated[float, msgspec.Meta(gt=0)]
    weight: float


class Provenance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a model was made of.

    Attributes:
        bundles: `<workspace>/<session>` -> SHA-256 of the manifest of its bundle, which holds the hashes of all files.
        succeeded: So many of them.
        seed: Of the folds.
        validation: Forecasts of each fifth of the cases by a model of the others.
    """

    bundles: dict[str, str]
    succeeded: int
    seed: int
    validation: TrackRecord


class LearnedModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What stands in the file.

    Attributes:
        intercept: Of the log odds, at the mean of every feature.
        covariance: (n + 1, n + 1) of the posterior of the intercept and the weights.
        causes: Skill -> coded cause -> failures.
    """

    model: Literal["phyagentos learned forecaster/1"] = "phyagentos learned forecaster/1"
    features: Annotated[tuple[Feature, ...], msgspec.Meta(max_length=FEATURES_MAX)]
    intercept: float
    covariance: tuple[tuple[float, ...], ...]
    causes: dict[str, dict[str, Annotated[int, msgspec.Meta(ge=1)]]]
    provenance: Provenance | None = None

    def foresee(self, features: Mapping[str, float], skill: str) -> Outcomes:
        """The distribution over outcomes of a session; an unknown category has the variance of the prior."""
        known = {each.name: each for each in self.features}
        x = np.array([1.0, *(_scale(features, each) for each in self.features)])
        odds = float(x @ np.array([self.intercept, *(each.weight for each in self.features)]))
        strange = sum(_is_category(name) and name not in known for name in features)
        variance = float(x @ np.array(self.covariance) @ x) + strange / PRECISION
        chance = float(expit(odds / math.sqrt(1.0 + math.pi * variance / 8.0)))
        spread = chance * (1.0 - chance)
        cases = max(1, round(min(1e6, 1.0 / max(1e-6, spread * variance) - 1.0)))
        causes = self.causes.get(skill) or sum((Counter(each) for each in self.causes.values()), Counter[str]())
        causes = causes or {CAUSE_UNKNOWN: 1}
        failed = cases * (1.0 - chance) / sum(causes.values())
        return Outcomes(
            samples=cases,
            succeeded=cases * chance,
            causes={cause: failed * count for cause, count in sorted(causes.items())},
        )


def fit_model(examples: Sequence[Example]) -> LearnedModel:
    """The model of some sessions, at least one; the same examples, the same bits."""
    names = sorted({name for each in examples for name in each.features})
    values = {name: [each.features[name] for each in examples if name in each.features] for name in names}
    features = [_make_feature(name, found) for name, found in values.items()]
    x = np.array([[1.0, *(_scale(each.features, feature) for feature in features)] for each in examples])
    y = np.array([not each.cause for each in examples], dtype=np.float64)
    precision = np.full(x.shape[1], PRECISION)
    precision[0] = 1.0 / PRECISION  # the base rate is hardly known before

    def compute_loss(weights: Array) -> tuple[float, Array]:
        odds = x @ weights
        loss = float(np.sum(np.logaddexp(0.0, odds) - y * odds) + 0.5 * weights @ (precision * weights))
        return loss, x.T @ (expit(odds) - y) + precision * weights

    weights = minimize(compute_loss, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B").x
    chance = expit(x @ weights)
    hessian = (x.T * (chance * (1.0 - chance))) @ x + np.diag(precision)
    causes: dict[str, Counter[str]] = {}
    for each in examples:
        if each.cause:
            causes.setdefault(each.skill, Counter())[each.cause] += 1
    return LearnedModel(
        features=tuple(
            msgspec.structs.replace(feature, weight=float(weight))
            for feature, weight in zip(features, weights[1:], strict=True)
        ),
        intercept=float(weights[0]),
        covariance=tuple(tuple(row) for row in np.linalg.inv(hessian).tolist()),
        causes={skill: dict(sorted(counted.items())) for skill, counted in sorted(causes.items())},
    )


def validate_model(examples: Sequence[Example], seed: int) -> TrackRecord:
    """What models of four fifths of the examples foresee of the last fifth, each in turn."""
    fold = np.random.default_rng(seed).permutation(len(examples)) % FOLDS
    scored = []
    for index in range(FOLDS):
        others = [each for each, mine in zip(examples, fold, strict=True) if mine != index]
        model = fit_model(others)
        mine = [each for each, own in zip(examples, fold, strict=True) if own == index]
        scored += [Scored(model.foresee(each.features, each.skill).share, not each.cause) for each in mine]
    return compute_record(scored)


def read_model(path: Path) -> tuple[LearnedModel, bytes]:
    """A model and the bytes of its file.

    Raises:
        DefinitionError: `INVALID_VALUE` for anything but a whole model.
    """
    expected, hint = "a model", "Make one with `python -m learned_forecaster`."
    try:
        data = read_regular(path)
        model = msgspec.json.decode(data, type=LearnedModel)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, OSError) as error:
        raise DefinitionError.of("INVALID_VALUE", str(path), str(error), expected, hint) from error
    size = len(model.features) + 1
    values = [model.intercept, *(value for each in model.features for value in (each.mean, each.scale, each.weight))]
    if len(model.covariance) != size or any(len(row) != size for row in model.covariance):
        found = f"a covariance that is not {size} x {size}"
    elif not (np.isfinite(values).all() and np.isfinite(model.covariance).all()):
        found = "a number that is not finite"
    elif not np.allclose(model.covariance, np.transpose(model.covariance)) or not _is_positive(model.covariance):
        found = "a covariance that is none of any weights"
    else:
        return model, data
    raise DefinitionError.of("INVALID_VALUE", str(path), found, expected, hint)


def _is_positive(covariance: Sequence[Sequence[float]]) -> bool:
    return bool(np.linalg.eigvalsh(covariance)[0] > 0.0)


def _make_feature(name: str, values: Sequence[float]) -> Feature:
    if _is_category(name):
        return Feature(name, 0.0, 1.0, 0.0)
    return Feature(name, float(np.mean(values)), float(np.std(values)) or 1.0, 0.0)


def _scale(features: Mapping[str, float], feature: Feature) -> float:
    value = features.get(feature.name)
    return 0.0 if value is None else (value - feature.mean) / feature.scale


def _is_category(name: str) -> bool:
    return "=" in name
