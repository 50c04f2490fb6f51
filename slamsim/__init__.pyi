from slamsim import dataset as dataset
from slamsim.api import Run as Run
from slamsim.api import check_recording as check_recording
from slamsim.api import localise as localise
from slamsim.api import make_dataset as make_dataset
from slamsim.api import map as map  # noqa: A004
from slamsim.api import open_session as open_session
from slamsim.api import simulate as simulate

__all__: list[str]
__version__: str
