"""Training of the learned forecaster: sessions of workspaces with a verdict, from their evidence to a model.

python -m learned_forecaster WORKSPACE... --to FILE      # exit code 1 where the base rate foresees it better
"""

import argparse
import hashlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from learned_forecaster.features import describe_case
from learned_forecaster.model import Example, LearnedModel, Provenance, fit_model, validate_model
from phyagentos.errors import DefinitionError, PhyAgentOSError
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.sessions.evidence import encode_json, read_bundle
from phyagentos.protocol.sessions.evidence_manifest import MANIFEST
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.forecast_record import iter_outcomes

CASES_MIN = 20


def train_model(workspaces: Sequence[Workspace], seed: int) -> tuple[LearnedModel, Provenance]:
    """A model of every sealed session of the workspaces that has a verdict and a first estimate; it holds the other.

    Raises:
        DefinitionError: With fewer than `CASES_MIN`.
        ExecutionError: `EVIDENCE_DAMAGED`, `JOURNAL_DAMAGED`.
    """
    found = {name: (digest, example) for each in workspaces for name, digest, example in iter_examples(each)}
    examples = [example for _, example in found.values()]
    if len(examples) < CASES_MIN:
        where = ", ".join(str(each.root) for each in workspaces)
        problem, hint = f"{len(examples)} sessions with a verdict", "Name more workspaces."
        raise DefinitionError.of("INVALID_VALUE", where, problem, f"at least {CASES_MIN}", hint)
    provenance = Provenance(
        bundles={name: digest for name, (digest, _) in found.items()},
        succeeded=sum(not each.cause for each in examples),
        seed=seed,
        validation=validate_model(examples, seed),
    )
    return msgspec.structs.replace(fit_model(examples), provenance=provenance), provenance


def iter_examples(workspace: Workspace) -> Iterator[tuple[str, str, Example]]:
    """`<workspace>/<session>`, the hash of the manifest of its bundle, and what is learned from."""
    for status, outcome in iter_outcomes(workspace):
        session, execution = status.contract, status.execution
        manifest = workspace.evidence_of(session.id) / MANIFEST
        if execution is None or not manifest.is_file():
            continue
        before = read_bundle(manifest.parent, session, execution, with_course=False).before
        if before is not None:
            digest = hashlib.sha256(manifest.read_bytes()).hexdigest()
            example = Example(describe_case(session, before), session.skill, outcome)
            yield f"{workspace.root.name}/{session.id}", digest, example


def main() -> int:
    """Train, write the model, say what it is worth."""
    parser = argparse.ArgumentParser(prog="learned_forecaster", description=__doc__)
    parser.add_argument("workspaces", nargs="+", type=Path, metavar="WORKSPACE", help="with sessions that were judged")
    parser.add_argument("--to", required=True, type=Path, metavar="FILE", help="where the model goes")
    parser.add_argument("--seed", type=int, default=0, help="of the fifths by which it is validated")
    given = parser.parse_args()
    try:
        model, trained = train_model([Workspace.open(each) for each in given.workspaces], given.seed)
    except PhyAgentOSError as error:
        print(error, file=sys.stderr)
        return 2
    replace_durably(given.to, encode_json(model))
    verdict = "; the base rate is better" if trained.validation.is_unfit(0) else ""
    print(f"{given.to}: {len(trained.bundles)} sessions, {trained.succeeded} succeeded")
    print(f"each fifth foreseen from the others: {trained.validation}{verdict}")
    return 1 if verdict else 0
