from koala3d.reconstruct.config import Config, SurfaceConfig


def test_every_setting_is_described() -> None:
    for section in Config.model_fields.values():
        for name, field in getattr(section.annotation, "model_fields", {}).items():
            assert field.description, name
    assert SurfaceConfig.model_fields["sampling"].description
