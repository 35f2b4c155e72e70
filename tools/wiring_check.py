#!/usr/bin/env python3
"""Shows every input of a stage controller and jogs one motor: for a cabinet that is wired for the first time.

    tools/wiring_check.py /dev/ttyACM0            inputs, live, until Ctrl-C
    tools/wiring_check.py /dev/ttyACM0 --jog 2    then 0.5 s upwards and back with motor 2, slowly
    tools/wiring_check.py tcp://127.0.0.1:5025    the same with a simulated stage

Needs Python 3.9 and, for a serial port, pyserial (pip install pyserial).
"""

import argparse
import socket
import sys
import time

AXES = ["X", "Y", "Z", "ALPHA", "BETA", "GAMMA"]
# STATus:AXIS<n>: driver fault
FAULT = 1 << 9


class Line:
    """A link that is asked one question at a time."""

    def __init__(self, name, baud):
        if name.startswith("tcp://"):
            host, port = name[len("tcp://"):].rsplit(":", 1)
            self.file = socket.create_connection((host, int(port)), timeout=5).makefile("rwb", buffering=0)
        else:
            try:
                import serial
            except ImportError:
                sys.exit("install pyserial: pip install pyserial")
            self.file = serial.Serial(name, baud, timeout=5)

    def tell(self, text):
        self.file.write(text.encode() + b"\n")

    def ask(self, text):
        self.tell(text)
        answer = self.file.readline().decode().strip()
        if not answer:
            sys.exit(f"no answer to {text}: is it the right port, and the right baud rate?")
        return answer


def inputs(line):
    """Lines of text: one for each motor, one for the emergency stop."""
    rows = []
    for n, name in enumerate(AXES, 1):
        lower, upper = line.ask(f"AXIS{n}:LIM:HARD?").split(",")
        fault = int(line.ask(f"STAT:AXIS{n}?")) & FAULT
        word = lambda active, text: text if active else "-" * len(text)
        rows.append(f"{n} {name:6} {word(int(lower), 'LOWER')} {word(int(upper), 'UPPER')} {word(fault, 'FAULT')}")
    latched, is_open = line.ask("SYST:EST:STAT?").split(",")
    contact = "OPEN" if int(is_open) else "closed"
    rows.append(f"emergency stop: contact {contact}{', latched (SYST:EST:CLE)' if int(latched) else ''}")
    return rows


def errors(line):
    answer = line.ask("SYST:ERR:ALL?")
    return [] if answer.startswith("0,") else [answer]


def jog(line, motor):
    """Half a second up and half a second down at a hundredth of the axis' velocity; says what the motor has counted."""
    axis = f"AXIS{motor}"
    velocity = float(line.ask(f"{axis}:VEL? MAX")) / 100
    line.tell(f"{axis}:ENAB ON")
    before = int(line.ask(f"{axis}:POS:MOT?"))
    try:
        for sense in (1, -1):
            line.tell(f"{axis}:MOVE:JOG {sense * velocity:.6f}")
            time.sleep(0.5)
            line.tell(f"{axis}:STOP")
            line.ask("*OPC?")
            print(f"motor {motor}: {int(line.ask(f'{axis}:POS:MOT?')) - before:+d} steps from where it was")
    finally:
        line.tell("!")
        line.tell(f"{axis}:ENAB OFF")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("port", help="serial port, or tcp://HOST:PORT")
    parser.add_argument("--baud", type=int, default=115200)
    parser.add_argument("--jog", type=int, choices=range(1, 7), metavar="1..6", help="motor to be moved a little")
    parser.add_argument("--once", action="store_true", help="show the inputs once")
    options = parser.parse_args()
    line = Line(options.port, options.baud)
    print(line.ask("*IDN?"))
    print("\n".join(errors(line) or ["no error"]))
    if options.jog:
        jog(line, options.jog)
    try:
        while True:
            rows = inputs(line)
            print("\n".join(rows))
            if options.once or options.jog:
                break
            time.sleep(0.2)
            print(f"\x1b[{len(rows)}A", end="")
    except KeyboardInterrupt:
        pass
    for error in errors(line):
        print(error)


if __name__ == "__main__":
    main()
