"""An independent simulator of flights, to test the gap workflow with causes it does not share.

Four motors with a lag of their own, thrust by the rotor speed squared, reaction torques, a mixer, a 500 Hz
controller and a 50 Hz pilot on *measured* state, a quaternion body integrated with RK4 at 2 kHz. One vehicle,
the reference, flies as the paper's equations say; families of others (`family.py`) differ in controller,
estimator, motors, battery, air and log. Nothing here reads models/, envs/ or the rest of eval/ (an import
contract holds it to that).
"""

from .family import FAMILIES, draw
from .flight import Reality, Recording, fly, reference
from .paths import KINDS, landing, ordinary
from .vehicle import Build, Constants, World, constants

__all__ = [
    "FAMILIES",
    "KINDS",
    "Build",
    "Constants",
    "Reality",
    "Recording",
    "World",
    "constants",
    "draw",
    "fly",
    "landing",
    "ordinary",
    "reference",
]
