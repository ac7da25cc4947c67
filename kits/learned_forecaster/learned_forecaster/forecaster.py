"""The forecaster `learned`: answers in a millisecond, for policies too, and only by what sessions like this came to."""

import hashlib
from dataclasses import dataclass

from msgspec.structs import asdict

from learned_forecaster.features import describe_case
from learned_forecaster.model import LearnedModel, read_model
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.lookahead import Forecast
from phyagentos.runtime.lookahead.forecaster import Case, ForecasterSite


@dataclass(frozen=True, slots=True)
class LearnedForecaster:
    """Foresees sessions by a model; `name` holds the hash of its file."""

    model: LearnedModel
    name: str

    def forecast(self, case: Case) -> Forecast:
        """What sessions with such features come to; never which other strategy would do better."""
        outcomes = self.model.foresee(describe_case(case.session, case.environment), case.session.skill)
        trained = self.model.provenance
        notes = (f"learned from {len(trained.bundles)} sessions",) if trained is not None else ()
        return Forecast(**asdict(outcomes), forecaster=self.name, notes=notes)


def open_learned(site: ForecasterSite) -> LearnedForecaster:
    """The model that the option `model` names, a path from the workspace on; raises DefinitionError."""
    file = site.options.get("model")
    if not isinstance(file, str):
        address = f"{site.workspace.runtime_contract}: forecasting.options.learned"
        hint = "Make one with `python -m learned_forecaster`."
        raise DefinitionError.of(
            "MISSING_VALUE", address, "no 'model'", "a file, by its path from the workspace on", hint
        )
    model, data = read_model(site.workspace.root / file)
    return LearnedForecaster(model, f"learned/1({hashlib.sha256(data).hexdigest()[:8]})")
