#!/usr/bin/env python3
"""Aligns a fibre, a 1x8 splitter chip and a fibre array: two stage controllers and a power meter, over VISA alone.
    align.py [VISA names of input side, output side and meter; without them those of `host-sim serve --bench`]
    align.py PRLGX-TCPIP::127.0.0.1::1234::INTFC GPIB0::5::INSTR GPIB0::6::INSTR GPIB0::7::INSTR
Lengths in um, angles in degrees, powers in dBm. Of the optics it knows what data sheets say."""
import math, sys, pyvisa

PITCH, REACH = 250, 152.3  # of the fibres, towards -x; gap that costs 3 dB: pi n (w1^2 + w2^2) / wavelength
LASER, DARK, SEARCH = 0, -52, 72  # power in the input fibre; what counts as light, and how wide it is looked for
BACK, GAP, STEP = 60, 13, 1.5  # to draw back before anything turns; gap that is wanted; to either side of a peak

def run(stage, command):  # waits until all that it begins has ended; an error ends the program
    error = stage.query(command + ";*OPC?;:SYST:ERR?").partition(";")[2]
    if not error.startswith("0,"):
        sys.exit(f"{stage.side} side: {command}: {error}")

def move(stage, x=0, y=0, z=0, gamma=0):
    run(stage, f"POSE:REL {x:.4f},{y:.4f},{z:.4f},0,0,{gamma:.6f}")

def scan(stage, kind, axis, span, end="PEAK", channel=1):  # about where it stands; the place of the peak
    step = {"PAR": 7, "LINE": span / 100}[kind]  # points at rest; or the way between samples in motion
    run(stage, f"SCAN:DEF:{kind} 0,{channel},{axis},{span},{step},{DARK},{end};:SCAN:STAR 0")
    return float(stage.query("SCAN:RES? 0").split(",")[3])

def peaks(span, *stages):
    for stage in stages:
        scan(stage, "LINE", 1, span), scan(stage, "LINE", 2, span)

def read(one=1, two=8):  # the light of two fibres, through the switch
    return [float(level) for level in meter.query(f"ROUT:CLOS 1,{one};CLOS 2,{two};:READ:POW? (@1,2)").split(",")]

def read_all():
    levels = [level for n in (1, 3, 5, 7) for level in read(n, n + 1)]
    for n, level in enumerate(levels, 1):
        if not DARK < level < 50:
            sys.exit(f"fibre {n}: " + ("no light" if level <= DARK else "the meter is saturated, or the bench broken"))
    return levels

def approach(stage, way=45):  # how far it still is, is told by how the light falls on the way back
    alpha, beta = (math.radians(float(angle)) for angle in stage.query("POSE?").split(",")[3:5])
    levels = []
    for _ in range(4):
        levels.append(read()[0])
        move(stage, -way * beta, way * alpha, -way)  # along the guides
    def spread(gap):  # of what each level would be without a gap
        tops = [level + 10 * math.log10(1 + ((gap + n * way) / REACH) ** 2) for n, level in enumerate(levels)]
        return max(tops) - min(tops)
    gap = min((0.1 * n for n in range(4000)), key=spread)
    if not GAP < gap < 350 or spread(gap) > 0.05:
        sys.exit(f"{stage.side} side: {levels} dBm, every {way} um, do not tell the gap")
    forth = 4 * way + gap - GAP
    move(stage, forth * beta, -forth * alpha, forth)
    print(f"  {stage.side} side: {gap:.1f} um were left, now {GAP}")

def star():  # the array to the mean of what five readings tell each channel to be its peak
    seen, x, y = [], 0, 0
    for to_x, to_y in (0, 0), (-STEP, 0), (STEP, 0), (0, -STEP), (0, STEP):
        move(array, to_x - x, to_y - y)
        seen, x, y = seen + [read_all()], to_x, to_y
    tops = [[STEP * (high - low) / (2 * (2 * levels[0] - low - high)) for low, high in (levels[1:3], levels[3:5])]
            for levels in zip(*seen)]
    mean_x, mean_y = (sum(places) / 8 for places in zip(*tops))
    roll = sum((3.5 - n) * top[1] for n, top in enumerate(tops)) / (42 * PITCH)  # a straight line through them
    move(array, mean_x - x, mean_y + 3.5 * PITCH * roll - y, gamma=math.degrees(roll))

names = sys.argv[1:] or [f"TCPIP::127.0.0.1::{port}::SOCKET" for port in (5025, 5026, 5027)]
ends, manager = dict(write_termination="\n", timeout=60_000), pyvisa.ResourceManager("@py")
*gateway, source, array, meter = (manager.open_resource(name, **ends) for name in names)
for link in source, array, meter:
    if "GPIB" not in link.resource_name:  # there EOI ends an answer
        link.read_termination = "\n"
source.side, array.side = "input", "output"
for stage in source, array:
    run(stage, "SENS1:INP LOG,20,-60;RANG 2.9;DEL 36 US;:SENS2:INP LOG,20,-60;RANG 2.9;DEL 36 US")
print("first light")
for stage, light in (source, "DET"), (array, 1):  # the input first, with the large-area detector behind the chip
    if read(light)[0] < DARK:
        stage.write(f"SCAN:DEF:SPIR 0,1,1,2,{SEARCH},0.4,8,{DARK},FIRS;:SCAN:STAR 0")
        print(f"  {stage.side} side searched:", stage.query("*OPC?;:SYST:ERR?").strip())
    peaks(SEARCH, stage)
print("pitch and yaw about the fibre, drawn back")
for stage in source, array:
    move(stage, z=-BACK)
    peaks(8, stage)
    scan(stage, "PAR", 4, 1.2), scan(stage, "PAR", 5, 1.2)
peaks(8, source, array)
print("roll by the first and the last channel")
first, last = (scan(array, "LINE", 2, 40, "STAR", channel) for channel in (1, 2))
move(array, gamma=math.degrees((first - last) / (7 * PITCH)))
peaks(8, source, array)
print("gap")
approach(array), approach(source)
print("last peaks")
peaks(4, source, array)
star()
read()
peaks(4, source)
for n, level in enumerate(read_all(), 1):
    print(f"CH{n}  {level:8.3f} dBm  loss {LASER - level:7.3f} dB")
if not (error := meter.query("SYST:ERR?")).startswith("0,"):
    sys.exit(f"meter: {error}")
