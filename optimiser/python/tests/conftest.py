"""What tests simulate."""

import pytest

import powderline as pl


@pytest.fixture(scope="session")
def scene():
    """`bench-small` on a grid twice as coarse: a rollout takes a tenth of a second."""
    return pl.Scene.load("bench-small").replace(name="tiny", domain={"cell_m": 0.008}, time={"substeps": 10})


@pytest.fixture(scope="session")
def file(scene, tmp_path_factory):
    """The same as a file."""
    path = tmp_path_factory.mktemp("scene") / "tiny.toml"
    path.write_text(scene.to_toml())
    return str(path)
