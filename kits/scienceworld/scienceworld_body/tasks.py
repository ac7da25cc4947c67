"""Which variations a split of the environment has of each task, with their descriptions, as JSON lines.

python -m scienceworld_body.tasks SPLIT COUNT       # the first so many of each; SPLIT is train, dev or test
"""

import json
import sys

from scienceworld import ScienceWorldEnv


def main() -> None:
    """Print them; of a task with fewer variations all."""
    split, count = sys.argv[1], int(sys.argv[2])
    env = ScienceWorldEnv("")
    for task in env.get_task_names():
        env.load(task, 0, "")
        listed = {"train": env.get_variations_train, "dev": env.get_variations_dev, "test": env.get_variations_test}
        for variation in listed[split]()[:count]:
            env.load(task, variation, "")
            print(json.dumps({"task": task, "variation": variation, "description": env.get_task_description()}))
    env.close()


main()
