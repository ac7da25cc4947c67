"""`python -m learned_forecaster`: see `training`."""

import sys

from learned_forecaster.training import main

sys.exit(main())
