from .agent import load_agent as load_agent
from .control.driver import ParkingDriver as ParkingDriver
from .control.driver import run_episode as run_episode
from .curriculum import Curriculum as Curriculum
from .parking.environment import SonarParkingEnv as SonarParkingEnv
from .parking.goal import SonarParkingGoalEnv as SonarParkingGoalEnv
from .parking.vector import SonarParkingVectorEnv as SonarParkingVectorEnv
from .sb3 import GoalExtractor as GoalExtractor
from .sb3 import SonarExtractor as SonarExtractor
from .sb3 import SonarVecEnv as SonarVecEnv
from .wrappers.observation import SonarObservation as SonarObservation
from .wrappers.observation import SonarVectorObservation as SonarVectorObservation

__version__: str
ENV_ID: str
GOAL_ENV_ID: str
ENVIRONMENTS: dict[str, tuple[str, float]]
