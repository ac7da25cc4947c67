"""`python -m rollout_forecaster`: see `calibration`."""

import sys

from rollout_forecaster.calibration import main

sys.exit(main())
