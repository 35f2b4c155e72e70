#!/usr/bin/env python3
"""The alignment loop of a bench whose PC has a GPIB: move, read the power, move on; then what each channel loses.
    gpib.py [gateway, input side, output side, meter; without them those of `host-sim serve --bench --gpib`]
The PC alone decides here; examples/align.py lets the stages scan by themselves, and aligns gap and all angles.
Lengths in um, angles in degrees, powers in dBm."""
import math, sys, time, pyvisa

PITCH, LASER, DARK = 250, 0, -52  # of the fibres; power in the input fibre; what counts as no light
READY = 32  # of the status byte: the standard event that *ESE 1 enables, operation complete

def wait(*stages):  # by serial poll, so that several may be under way
    for stage in stages:
        while not stage.read_stb() & READY:
            time.sleep(0.002)
        if stage.query("*ESR?;:SYST:ERR?").strip() != '1;0,"No error"':
            sys.exit(f"{stage.resource_name}: stopped by an error")

def move(stage, axis, distance):
    stage.write(f"AXIS{axis}:MOVE:REL {distance:.5f};*OPC")
    wait(stage)

def read(fibre):
    return float(meter.query(f"ROUT:CLOS 1,{fibre};:READ:POW? (@1)"))

def climb(stage, axis, step, fibre):  # until the best place has a worse one on either side; how far it went
    at, top, seen = 0, 0, {}
    while missing := [n for n in (top, top + 1, top - 1) if n not in seen]:
        move(stage, axis, (missing[0] - at) * step)
        at, seen[missing[0]] = missing[0], read(fibre)
        top = max(seen, key=seen.get)
    low, here, high = (seen[top + n] for n in (-1, 0, 1))
    vertex = top + (high - low) / (2 * (2 * here - low - high))  # of the parabola through the three
    move(stage, axis, (vertex - at) * step)
    return vertex * step

def peak(fibre, *stages, steps=(4, 1, 0.4)):
    for step in steps:
        for stage in stages:
            climb(stage, 1, step, fibre), climb(stage, 2, step, fibre)

names = sys.argv[1:] or ["PRLGX-TCPIP::127.0.0.1::1234::INTFC"] + [f"GPIB0::{n}::INSTR" for n in (5, 6, 7)]
manager = pyvisa.ResourceManager("@py")
gateway, *links = (manager.open_resource(name, write_termination="\n", timeout=60_000) for name in names)
source, array, meter = links
for stage, light in (source, "DET"), (array, 1):  # the input first, with the large-area detector behind the chip
    stage.write("*CLS;*ESE 1;:SENS1:INP LOG,20,-60")
    if read(light) < DARK:  # too far for a climb: the stage looks for light
        stage.write(f"SCAN:DEF:SPIR 0,1,1,2,72,0.4,8,{DARK},FIRS;:SCAN:STAR 0;*OPC")
        wait(stage)
    peak(light, stage)
peak(1, source, array, steps=(1, 0.4))
print("first light on channel 1")
shift = climb(array, 2, 1, 8)  # roll by the first and the last channel, about the first
move(array, 2, -shift)
move(array, 6, math.degrees(-shift / (7 * PITCH)))
print(f"roll turned by {math.degrees(-shift / (7 * PITCH)):.4f}")
peak(1, array, steps=(1, 0.4))
peak(1, source, steps=(0.4,))
for channel in range(1, 9):
    print(f"CH{channel}  {(level := read(channel)):8.3f} dBm  loss {LASER - level:7.3f} dB")
