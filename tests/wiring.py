#!/usr/bin/env python3
"""The pins of the board are the same everywhere: code, its table, the README's table and the picture."""

import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
PINS = (ROOT / "src/board/pins.rs").read_text()
PORT_E = (ROOT / "src/words/stepgen/pins.rs").read_text()
README = (ROOT / "README.md").read_text()
PICTURE = (ROOT / "docs/wiring.svg").read_text()

# signal of the tables -> constant of the code
SIGNALS = {
    "limit switch lower": "LOWER",
    "limit switch upper": "UPPER",
    "driver fault": "FAULT",
    "driver enable": "ENABLE",
    "emergency stop": "STOP",
    "optical power": "POWER",
}


def of_the_code():
    """Pins of every signal, as `PE6` and so on."""
    pins = {}
    for signal, constant in SIGNALS.items():
        text = re.search(rf"pub const {constant}: [^=]*= (.*?);", PINS, re.S).group(1)
        pins[signal] = [f"P{port}{line}" for port, line in re.findall(r"Pin\((\w), (\d+)\)", text)]
    for signal, constant in {"STEP": "STEP_PINS", "DIR": "DIR_PINS", "trigger output": "TRIGGER_PIN"}.items():
        text = re.search(rf"pub const {constant}: [^=]*= (.*?);", PORT_E).group(1)
        pins[signal] = [f"PE{line}" for line in re.findall(r"\d+", text)]
    return pins


def of_a_table(lines):
    """Pins of every row of a Markdown table whose cells are signal, pins, note."""
    table = {}
    for line in lines:
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) >= 4:
            signal = re.sub(r" 1(\s*(…|\.\.)\s*6|, 2)$", "", cells[1])
            table[signal] = re.findall(r"P[A-E]\d+", cells[2])
    return table


def main():
    code = of_the_code()
    tables = {
        "the table in src/board/pins.rs": of_a_table(line for line in PINS.splitlines() if line.startswith("//! |")),
        "the README": of_a_table(line for line in README.splitlines() if line.startswith("|")),
    }
    wrong = []
    for name, table in tables.items():
        for signal, pins in code.items():
            if table.get(signal) != pins:
                wrong.append(f"{signal} is {pins} in the code and {table.get(signal)} in {name}")
    picture = set(re.findall(r"P[A-E]\d+", PICTURE))
    for signal, pins in code.items():
        wrong += [f"{pin} ({signal}) is missing in docs/wiring.svg" for pin in pins if pin not in picture]
    used = [pin for pins in code.values() for pin in pins]
    wrong += [f"{pin} is used twice" for pin in sorted(set(used)) if used.count(pin) > 1]
    if len(used) < 40:
        wrong.append(f"only {len(used)} pins found in the code: has its shape changed?")
    print("\n".join(wrong) or f"{len(used)} pins agree")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
