"""Runs where unified-planning is: whether a plan, names of actions on stdin, is valid; and a plan of ENHSP's own.

Arguments: domain.pddl, problem.pddl, and `solve` for that plan. Prints JSON: `valid`, `plan`.
"""

import json
import sys

from unified_planning.engines import SequentialPlanValidator
from unified_planning.io import PDDLReader
from unified_planning.plans import ActionInstance, SequentialPlan
from unified_planning.shortcuts import OneshotPlanner, get_environment

get_environment().credits_stream = None
problem = PDDLReader().parse_problem(sys.argv[1], sys.argv[2])
ours = SequentialPlan([ActionInstance(problem.action(name)) for name in json.load(sys.stdin)])
verdict = SequentialPlanValidator().validate(problem, ours)
names = []
if "solve" in sys.argv:
    with OneshotPlanner(name="enhsp") as planner:
        names = [each.action.name for each in planner.solve(problem).plan.actions]
sys.stdout.write(json.dumps({"valid": bool(verdict), "plan": names}))
