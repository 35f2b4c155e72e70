"""What the firmware costs while it streams and nothing moves: `python tests/emulator/measure.py <elf>`."""

import sys
import time

from stm32f4 import Board

SECONDS = 0.5
TIM2_IRQ = 28


def main(path):
    board = Board(path)
    board.pin("A", 0, 1)
    board.run(200_000)
    board.serial.query("*IDN?")
    board.stats.clear()
    began, instructions = time.process_time(), board.core.state.count
    board.run(SECONDS * 1e6)
    spent, instructions = time.process_time() - began, board.core.state.count - instructions
    stats = board.stats
    print(f"emulation: {SECONDS / spent:.2f} of real time, {instructions / spent / 1e6:.0f} million instructions a second")
    print(f"load: {100 * instructions * 1.5 / (SECONDS * board.rcc.system_hz):.0f} % of the core at 1.5 cycles an instruction")
    entries, longest = stats.irq_entries(TIM2_IRQ), stats.longest[16 + TIM2_IRQ]
    print(f"refill: {stats.irq_instructions(TIM2_IRQ) / entries:.0f} instructions on average, {longest} at most, of {entries}")
    print(f"refill begins {min(stats.refill_latency_us)} to {max(stats.refill_latency_us)} us after its tick")
    for us, times, name in board.longest_masked()[:3]:
        print(f"masked: {us:.2f} us at most, {times} times, in {name}")
    print(f"stack: {board.stack_used()} bytes of 65536")


if __name__ == "__main__":
    main(sys.argv[1])
