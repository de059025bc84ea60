from .mystery import Score as Score
from .mystery import make_mystery as make_mystery
from .mystery import reveal as reveal
