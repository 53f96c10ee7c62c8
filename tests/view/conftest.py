"""What the reports of all packages are made of, from the tests of their contents."""

from tests.capture.page.test_report import recorded as recorded
from tests.reconstruct.conftest import ball as ball
from tests.reconstruct.conftest import ball_scene as ball_scene
from tests.reconstruct.conftest import make_run as make_run
from tests.reconstruct.conftest import renderer as renderer
from tests.reconstruct.conftest import small_config as small_config
from tests.reconstruct.conftest import without_mesh as without_mesh
from tests.reconstruct.experiments.conftest import make_row as make_row
