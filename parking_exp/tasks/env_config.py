"""The `env` group: the config of one of the tasks, chosen by its key `task`."""

from typing import Annotated

from pydantic import Field

from parking_exp.tasks.gymnasium_config import GymnasiumConfig
from parking_exp.tasks.parking.parking_config import ParkingConfig

EnvConfig = Annotated[ParkingConfig | GymnasiumConfig, Field(discriminator="task")]
TASKS = ("parking", "gymnasium")
