"""Makes a small ACT policy with random weights that stays near one posture; for the environment of `--lerobot-python`.

    python with_lerobot.py make_act.py FOLDER < OBSERVATION

An observation is JSON of `state` and `front`, and of `near`, the row that it stays near; its answer is printed.
"""

import json
import sys

import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

SPREAD = 1e-3  # so that no row is further from the one before than an arm can follow

torch.manual_seed(7)
folder, shown = sys.argv[1], json.load(sys.stdin)
state, front = torch.tensor(shown["state"]), torch.tensor(shown["front"], dtype=torch.float32)
config = ACTConfig(
    input_features={
        "observation.state": PolicyFeature(FeatureType.STATE, tuple(state.shape)),
        "observation.images.front": PolicyFeature(FeatureType.VISUAL, (3, *front.shape[:2])),
    },
    output_features={"action": PolicyFeature(FeatureType.ACTION, (len(shown["near"]),))},
    chunk_size=12,
    n_action_steps=12,
    dim_model=32,
    n_heads=2,
    dim_feedforward=32,
    n_encoder_layers=1,
    use_vae=False,
    pretrained_backbone_weights=None,
    device="cpu",
)
policy = ACTPolicy(config)
with torch.no_grad():
    policy.model.action_head.weight *= SPREAD
    policy.model.action_head.bias[:] = torch.tensor(shown["near"])
policy.save_pretrained(folder)
before, after = make_pre_post_processors(config)
before.save_pretrained(folder)
after.save_pretrained(folder)
observation = {"observation.state": state[None], "observation.images.front": front.permute(2, 0, 1)[None] / 255}
with torch.no_grad():
    rows = policy.predict_action_chunk(before(observation))[0]
sys.stdout.write(json.dumps(rows.tolist()))
