"""The C and what hangs on it: source, detector, sensor."""

from carm_family.parts import ZERO, Shape, Stage, Vector, arc, box, cylinder

C_SECTION = 0.06, 0.12


def half_circle(radius: float) -> tuple[Shape, ...]:
    """A C that opens along x."""
    return arc(radius, 90, 270, 9, C_SECTION)


def imaging(
    carrier: str,
    source: Vector,
    detector: Vector,
    sensor: Vector,
    sensor_rpy: Vector = ZERO,
    *,
    suffix: str = "",
    size: float = 1.0,
) -> tuple[Stage, ...]:
    """Source, detector and sensor on the C, at these places in its frame; the beam runs along z."""
    post = [b - a for a, b in zip(detector, sensor, strict=True)]
    on_top = 0.1 * size
    length = post[2] - on_top
    return (
        Stage(
            f"source{suffix}_mount",
            carrier,
            f"source{suffix}",
            source,
            shapes=(box((0.26 * size, 0.24 * size, 0.34 * size), (0, 0, 0.07 * size)),),
            comment="Source: frame at the focal spot, z along the beam.",
        ),
        Stage(
            f"detector{suffix}_mount",
            carrier,
            f"detector{suffix}",
            detector,
            shapes=(
                box((0.34 * size, 0.34 * size, on_top), (0, 0, on_top / 2)),
                cylinder(0.01, length, (post[0], post[1], on_top + length / 2)),
            ),
            comment="Detector: frame in the middle of its face, z along the beam. A post on it bears the sensor.",
        ),
        Stage(
            f"sensor{suffix}_mount",
            carrier,
            f"sensor{suffix}",
            sensor,
            sensor_rpy,
            shapes=(box((0.08, 0.08, 0.012)),),
            comment="Sensor: an optical marker.",
        ),
    )
