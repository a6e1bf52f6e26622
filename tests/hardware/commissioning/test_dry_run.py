"""What a dry run displays of a robot that is moved by hand."""

from stepgap.hardware.commissioning.dry_run import Travelled


def test_travels_begin_when_the_foot_is_put_on_the_ground() -> None:
    travelled = Travelled()
    assert travelled.describe({}) == {}
    assert travelled.describe({"by yaw": 1.0, "by leg": -0.2}) == {"by yaw": "+0.0 mm", "by leg": "+0.0 mm"}
    assert travelled.describe({"by yaw": 1.02, "by leg": -0.181}) == {"by yaw": "+20.0 mm", "by leg": "+19.0 mm"}
    assert travelled.describe({}) == {}, "the foot is in the air"
    assert travelled.describe({"by yaw": 1.5, "by leg": 0.0}) == {"by yaw": "+0.0 mm", "by leg": "+0.0 mm"}
