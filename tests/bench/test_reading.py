from tests.bench import reading


def test_photographs_are_read_in_three_ways() -> None:
    found = reading.read_photographs(3, width=640, height=480, scale=0.1)
    assert (found["images"], found["small_width"], found["small_height"]) == (3, 64, 48)
    assert min(found["opencv_seconds"], found["seconds"], found["again_seconds"]) > 0
    assert 0 < found["mean_difference"] < 1 and found["mean_difference"] < found["largest_difference"] < 8  # strong texture


def test_without_a_reduction_nothing_differs() -> None:
    found = reading.read_photographs(1, width=320, height=240, scale=0.5)
    assert found["largest_difference"] == 0
