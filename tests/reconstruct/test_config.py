from koala3d.reconstruct.config import Config, LossConfig, SurfaceConfig


def test_every_setting_is_described() -> None:
    for section in Config.model_fields.values():
        for name, field in getattr(section.annotation, "model_fields", {}).items():
            assert field.description, name
    assert SurfaceConfig.model_fields["neighbours"].description


def test_weights_of_bounded_scenes_take_the_place_of_the_others_there() -> None:
    losses = LossConfig(distortion=0.01, decay=0.1, bounded_decay=10)
    assert losses.in_scene(bounded=False) == losses
    bounded = losses.in_scene(bounded=True)
    assert (bounded.distortion, bounded.decay) == (0.01, 10)
    assert LossConfig(distortion=0.01, bounded_distortion=0).in_scene(bounded=True).distortion == 0
    assert LossConfig(fog=0.01, bounded_fog=0).in_scene(bounded=True).fog == 0
