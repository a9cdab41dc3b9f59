"""An independent simulator of flights, to test the gap workflow with causes it does not share.

Four motors with a lag of their own, thrust by the rotor speed squared, reaction torques, a mixer, a 500 Hz
cascaded controller and a 50 Hz pilot on *measured* state, a quaternion body integrated with RK4 at 2 kHz.
Nothing here reads models/, envs/ or the rest of eval/ (an import contract and a test hold it to that).
"""

from .flight import Recording, fly
from .paths import KINDS, landing, ordinary
from .vehicle import Constants, World, constants

__all__ = ["KINDS", "Constants", "Recording", "World", "constants", "fly", "landing", "ordinary"]
