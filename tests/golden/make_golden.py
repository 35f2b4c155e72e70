#!/usr/bin/env python3
"""Golden vectors of the exact compensation law, in pure Python and apart from the Rust code.

    make_golden.py MACHINE.toml -o FILE.json [--seed N] [--count N]
    make_golden.py --check FILE.json [FILE.json ...]

The law is docs/LAW.md 2 in float64 with the screws of the stage: angles by chord Newton, rotation
centre screw by screw from tip to base, then the inverse of the slide directions. Poses are random
within the motors' travel; every second one is a small move. --check computes a file's poses anew
and fails when an actuator differs by more than 0.01 nm or nrad.
"""
import argparse
import json
import math
import random
import sys
import tomllib

AXES = ["X", "Y", "Z", "alpha", "beta", "gamma"]
UNIT = {"X": (1, 0, 0), "Y": (0, 1, 0), "Z": (0, 0, 1), "alpha": (1, 0, 0), "beta": (0, 1, 0), "gamma": (0, 0, 1)}
LINEAR, ROTARY = AXES[:3], AXES[3:]
TOLERANCE = 0.01


def mat_vec(m, v):
    return [sum(m[i][k] * v[k] for k in range(3)) for i in range(3)]


def mat_mul(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def transpose(m):
    return [list(row) for row in zip(*m)]


def add(a, b):
    return [x + y for x, y in zip(a, b)]


def sub(a, b):
    return [x - y for x, y in zip(a, b)]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def columns(vectors):
    return transpose(vectors)


def inverse(m):
    a, b, c = transpose(m)
    volume = dot(a, cross(b, c))
    return [[x / volume for x in row] for row in (cross(b, c), cross(c, a), cross(a, b))]


IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def turn(axis, angle, v):
    """v turned about a unit axis: v + sin(angle) w x v + 2 sin^2(angle/2) w x (w x v)."""
    once = cross(axis, v)
    twice = cross(axis, once)
    s, c = math.sin(angle), 2.0 * math.sin(0.5 * angle) ** 2
    return [v[i] + s * once[i] + c * twice[i] for i in range(3)]


def exponential(vector):
    angle = math.sqrt(dot(vector, vector))
    if angle == 0.0:
        return IDENTITY
    axis = [x / angle for x in vector]
    return columns([turn(axis, angle, e) for e in IDENTITY])


def static_vector(axis, upstream, statics):
    """Static errors of a joint; a squareness sits on the later of its two axes, about the third."""
    e = lambda name: float(statics.get(name, 0.0))
    if axis in LINEAR:
        vector = [0.0, 0.0, 0.0]
        for pair, about in (("ZY", 0), ("ZX", 1), ("XY", 2)):
            if axis in pair and pair.replace(axis, "") in upstream:
                vector[about] = e("S_" + pair)
        return vector
    return {
        "alpha": [0.0, e("ey_alpha"), e("ez_alpha")],
        "beta": [e("ex_beta"), 0.0, e("ez_beta")],
        "gamma": [e("ex_gamma"), e("ey_gamma"), 0.0],
    }[axis]


class Law:
    """The stage's screws at home and the exact inverse; lengths in nm, angles in rad."""

    def __init__(self, machine):
        order = machine["order"]
        if sorted(order) != sorted(AXES):
            raise SystemExit(f"order = {order}: not a permutation of {AXES}")
        self.rotary = [a for a in order if a in ROTARY]
        if order[3:] != self.rotary:
            raise SystemExit(f"order = {order}: a linear axis behind a rotary one has no constant D")
        rotation, origin = IDENTITY, [0.0, 0.0, 0.0]
        self.direction, self.point = {}, {}
        for k, axis in enumerate(order):
            offset = machine.get("axis_offset_um", {}).get(axis, [0.0, 0.0, 0.0])
            origin = add(origin, mat_vec(rotation, [1e3 * x for x in offset]))
            tilt = exponential(static_vector(axis, order[:k], machine.get("static_rad", {})))
            rotation = mat_mul(rotation, tilt)
            self.direction[axis] = mat_vec(rotation, UNIT[axis])
            self.point[axis] = origin
        self.home = add(origin, mat_vec(rotation, [1e3 * x for x in machine["fibre_point_um"]]))
        self.slides_inverse = inverse(columns([self.direction[a] for a in LINEAR]))
        self.axes_inverse = inverse(columns([self.direction[a] for a in ROTARY]))

    def product(self, axes, angles):
        rotation = IDENTITY
        for name in self.rotary:
            axis = axes[name]
            one = columns([turn(axis, angles[name], e) for e in IDENTITY])
            rotation = mat_mul(rotation, one)
        return rotation

    def angles(self, logical):
        wanted = self.product(UNIT, dict(zip(ROTARY, logical)))
        q = mat_vec(self.axes_inverse, logical)
        for _ in range(30):
            now = self.product(self.direction, dict(zip(ROTARY, q)))
            r = mat_mul(wanted, transpose(now))
            rest = [0.5 * (r[2][1] - r[1][2]), 0.5 * (r[0][2] - r[2][0]), 0.5 * (r[1][0] - r[0][1])]
            q = add(q, mat_vec(self.axes_inverse, rest))
        return q

    def actuators(self, pose):
        """Actuators in nm and nrad of a pose in nm and nrad."""
        q = self.angles([1e-9 * u for u in pose[3:]])
        v = self.home
        for name in reversed(self.rotary):
            centre = self.point[name]
            v = add(centre, turn(self.direction[name], q[ROTARY.index(name)], sub(v, centre)))
        linear = mat_vec(self.slides_inverse, sub(pose[:3], sub(v, self.home)))
        return linear + [1e9 * x for x in q]


def travel_and_step(machine):
    for axis in AXES:
        stage = machine["axes"][axis]
        if axis in LINEAR:
            yield [1e3 * x for x in stage["travel_um"]], stage["step_nm"]
        else:
            yield [1e9 * math.radians(x) for x in stage["travel_deg"]], stage["step_nrad"]


def vector(law, pose, steps):
    actuators = law.actuators(pose)
    return {
        "pose_nm_nrad": pose,
        "actuator_nm_nrad": [round(q, 4) for q in actuators],
        "motor_steps_exact": [round(q / step, 4) for q, step in zip(actuators, steps)],
    }


def make(machine, seed, count):
    law = Law(machine)
    stages = list(travel_and_step(machine))
    steps = [step for _, step in stages]
    rng = random.Random(seed)
    poses = []
    while len(poses) < count:
        scale = 1.0 if len(poses) % 2 == 0 else 0.02
        pose = [round(scale * rng.uniform(lower, upper)) for (lower, upper), _ in stages]
        one = vector(law, pose, steps)
        if all(lo <= q <= hi for q, ((lo, hi), _) in zip(one["actuator_nm_nrad"], stages)):
            poses.append(one)
    return {
        "machine": machine,
        "units": "pose and actuator: x,y,z in nm; alpha,beta,gamma in nrad",
        "law": "exact inverse, float64; backlash off",
        "poses": poses,
    }


def check(path):
    with open(path, encoding="utf-8") as file:
        golden = json.load(file)
    law = Law(golden["machine"])
    steps = [step for _, step in travel_and_step(golden["machine"])]
    worst = worst_step = 0.0
    for one in golden["poses"]:
        mine = law.actuators(one["pose_nm_nrad"])
        for q, theirs, counts, step in zip(mine, one["actuator_nm_nrad"], one["motor_steps_exact"], steps):
            worst = max(worst, abs(q - theirs))
            worst_step = max(worst_step, abs(q - counts * step))
    # Counts are written with four decimals, so a step of 4000 nrad allows 0.2 nrad of rounding.
    good = worst <= TOLERANCE and worst_step <= TOLERANCE + 1e-4 * max(steps)
    print(f"{path}: {len(golden['poses'])} poses, worst {worst:.6f} nm or nrad{'' if good else '  WRONG'}")
    return good and golden["poses"] != []


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("machine", nargs="?", help="machine file (TOML)")
    parser.add_argument("-o", "--output", help="golden file to write")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--check", nargs="+", metavar="FILE", help="compute golden files anew and compare")
    args = parser.parse_args()
    if args.check:
        sys.exit(0 if all([check(path) for path in args.check]) else 1)
    if not (args.machine and args.output):
        parser.error("a machine file and -o are needed (or --check)")
    with open(args.machine, "rb") as file:
        machine = tomllib.load(file)
    with open(args.output, "w", encoding="utf-8") as file:
        json.dump(make(machine, args.seed, args.count), file, indent=1)
        file.write("\n")


if __name__ == "__main__":
    main()
