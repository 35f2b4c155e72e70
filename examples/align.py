#!/usr/bin/env python3
"""Aligns a fibre, a 1x8 splitter chip and a fibre array: two stage controllers and a power meter, over VISA alone.
    align.py [VISA names of input side, output side and meter; without them those of `host-sim serve --bench`]
    align.py PRLGX-TCPIP::127.0.0.1::1234::INTFC GPIB0::5::INSTR GPIB0::6::INSTR GPIB0::7::INSTR
Lengths in um, angles in degrees, powers in dBm. Of the optics it knows the pitch alone."""
import math, statistics, sys, time, pyvisa

PITCH = 250  # of the fibres, towards -x
LASER, DARK, SEARCH = 0, -52, 72  # power in the input fibre; what counts as light, and how wide it is looked for
BACK, GAP, WAY = 60, 13, 45  # to draw back before anything turns; gap that is wanted; of a step that tells the gap

def wait(stage, command):  # until all that it begins has ended; no read is longer than a gateway's time-out
    stage.write(f"*CLS;:{command};*OPC")
    while stage.query("*ESR?").strip() == "0":
        time.sleep(0.001)
    return stage.query("SYST:ERR?").strip()

def run(stage, command):  # an error ends the program
    if not (error := wait(stage, command)).startswith("0,"):
        sys.exit(f"{stage.side} side: {command}: {error}")

def move(stage, x=0, y=0, z=0, gamma=0):
    run(stage, f"POSE:REL {x:.4f},{y:.4f},{z:.4f},0,0,{gamma:.6f}")

def look(light, must=True):  # at a fibre of the array, or at the detector behind the chip
    level = float(meter.query(f"ROUT:CLOS 1,{light};:READ:POW? (@1)"))
    if must and not DARK < level < 50:
        sys.exit(f"fibre {light}: " + ("no light" if level <= DARK else "the meter is saturated, or the bench broken"))
    return level

def scan(stage, kind, axis, span, light=1, end="PEAK"):  # about where it stands; how far from its end the peak is
    look(light)
    step = {"PAR": 7, "LINE": span / 100}[kind]  # points at rest; or the way between samples in motion
    run(stage, f"SCAN:DEF:{kind} 0,1,{axis},{span},{step},{DARK},{end};:SCAN:STAR 0")
    level, peak, _, stands = map(float, stage.query("SCAN:RES? 0").split(",")[2:])
    print(f"{stage.side} side, axis {axis}, fibre {light}: {level:.3f} dBm")
    return peak - stands

def peaks(stage, span, light=1):  # x, then y
    scan(stage, "LINE", 1, span, light), scan(stage, "LINE", 2, span, light)

def balance(span, *fibres):  # the array to the mean of where these have their peaks; roll is the slope of the line
    ways = [[scan(array, "LINE", axis, span, fibre, "STAR") for axis in (1, 2)] for fibre in fibres]
    x, y = zip(*ways)
    roll, y_of_first = statistics.linear_regression([PITCH * (1 - fibre) for fibre in fibres], y)
    move(array, statistics.mean(x), y_of_first, gamma=math.degrees(roll))

def along(stage, way):  # the axis of the guides, as the angles say how it lies
    alpha, beta = (math.radians(float(angle)) for angle in stage.query("POSE?").split(",")[3:5])
    move(stage, way * beta, -way * alpha, way)

def approach(stage):  # half of the way, and the rest; how far it is, is told by how the light falls on the way back
    for share in 0.5, 1:
        peaks(stage, 4)
        losses = []  # a parabola over the way; its least value would be where the faces touch
        for _ in range(4):
            losses.append(10 ** (-look(1) / 10))
            along(stage, -WAY)
        a, b, c, d = losses
        bend, third = a - b - c + d, d - 3 * c + 3 * b - a
        gap = WAY * ((3 * (d - a) + c - b) / (5 * bend) - 1.5) if bend > 0 else 0
        if not GAP < gap < 350 or abs(third) > 0.01 * a:
            sys.exit(f"{stage.side} side: losses {losses}, every {WAY} um, do not tell the gap")
        along(stage, 4 * WAY + share * (gap - GAP))
        print(f"{stage.side} side: {gap:.1f} um were left, now {gap - share * (gap - GAP):.1f}")

names = sys.argv[1:] or [f"TCPIP::127.0.0.1::{port}::SOCKET" for port in (5025, 5026, 5027)]
ends, manager = dict(write_termination="\n", timeout=60_000), pyvisa.ResourceManager("@py")
*gateway, source, array, meter = (manager.open_resource(name, **ends) for name in names)
for link in source, array, meter:
    if "GPIB" not in link.resource_name:  # there EOI ends an answer
        link.read_termination = "\n"
source.side, array.side = "input", "output"
for stage, light in (source, "DET"), (array, 1):  # first light; the input first, with the detector behind the chip
    run(stage, "SENS1:INP LOG,20,-60;RANG 2.9;DEL 36 US")
    if look(light, must=False) < DARK:
        found = wait(stage, f"SCAN:DEF:SPIR 0,1,1,2,{SEARCH},0.4,8,{DARK + 2},FIRS;:SCAN:STAR 0")
        print(f"{stage.side} side searched:", found)
    peaks(stage, SEARCH, light)
for stage in source, array:  # pitch and yaw about the fibre, drawn back
    move(stage, z=-BACK)
    peaks(stage, 8)
    scan(stage, "PAR", 4, 1.2), scan(stage, "PAR", 5, 1.2)
peaks(source, 8), peaks(array, 8)
balance(40, 1, 8)
peaks(source, 8), peaks(array, 8)
approach(array), approach(source)
peaks(source, 4)
balance(6, *range(1, 9))
peaks(source, 4)
for fibre in range(1, 9):
    print(f"CH{fibre}  {(level := look(fibre)):8.3f} dBm  loss {LASER - level:7.3f} dB")
if not (error := meter.query("SYST:ERR?")).startswith("0,"):
    sys.exit(f"meter: {error}")
