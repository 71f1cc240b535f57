"""Made recordings in which an axis, or both, hardly turn: the C-arm of `helpers.chained`, in closed form."""

import numpy as np

from carm_kin.recording.recording import Recording
from helpers.chained import C_ARM, kinematics, noisy
from helpers.simulated import frame

N = 120
SIGMA_T, SIGMA_R = 0.2e-3, np.radians(0.1)
UNTOLD = (
    "rest",
    "angular alone",
    "orbital alone",
    "angular, wobble",
    "orbital, wobble",
    "orbital, jitter",
    "short arcs",
    "orbital, short angular arc",
    "angular, short orbital arc",
)
BOTH = "both"


def angles(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """alpha and beta (N,), rad: arcs of 100 to 150 degrees, wobble and jitter of 0.1, short arcs of 2 degrees."""
    rng = np.random.default_rng([seed, 31])
    s, phase = np.linspace(0, 1, N), rng.uniform(0, 6, 3)
    big = np.radians(rng.uniform(50, 75)) * np.sin(2 * np.pi * s + phase[0])
    wobble = np.radians(0.1) * np.sin(6 * np.pi * s + phase[1])
    short = np.radians(1.0) * np.sin(6 * np.pi * s + phase[2])
    still, jitter = np.zeros(N), np.radians(0.1) * rng.normal(size=N)
    return {
        "rest": (still, still),
        "angular alone": (big, still),
        "orbital alone": (still, big),
        "angular, wobble": (big, wobble),
        "orbital, wobble": (wobble, big),
        "orbital, jitter": (jitter, big),
        "short arcs": (short, np.radians(1.0) * np.cos(2 * np.pi * s + phase[0])),
        "orbital, short angular arc": (short, big),
        "angular, short orbital arc": (big, short),
        BOTH: (0.6 * big, np.radians(60) * np.cos(7 * np.pi * s + phase[1])),
    }[kind]


def base(seed: int) -> np.ndarray:
    """T_world_base (4, 4)."""
    return frame(np.random.default_rng([seed, 32]), 1.0)


def poses(kind: str, seed: int, sigma_t: float = SIGMA_T, sigma_r: float = SIGMA_R) -> np.ndarray:
    """T_world_sensor (N, 4, 4)."""
    alpha, beta = angles(kind, seed)
    T = base(seed) @ kinematics(C_ARM, "sensor", {"angular": alpha, "orbital": beta})
    return noisy(T, sigma_t, sigma_r, seed)


def recording(kind: str, seed: int, read: bool = False) -> Recording:
    """Without labels; where the joints are ``read``, with 0.05 degrees of noise."""
    T, rng, joints = poses(kind, seed), np.random.default_rng([seed, 33]), {}
    if read:
        values = zip(("angular", "orbital"), angles(kind, seed), strict=True)
        joints = {name: q + np.radians(0.05) * rng.normal(size=N) for name, q in values}
    return Recording(T[:, :3, 3], T[:, :3, :3], joints=joints)
