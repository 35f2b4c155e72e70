"""The emulator itself: small programs in machine code, and its peripherals by their registers."""

import struct

import pytest

from stm32f4 import Board, Image, PowerCut
from stm32f4.nvic import HARD_FAULT, NMI

RAM = 0x2000_0000
ASLEEP = (0xBF30, 0xE7FD)  # wfi; b .-2
# ldr r0, =word; ldr r1, [r0]; adds r1, #1; str r1, [r0]; bx lr; nop; the word's address follows
COUNTER = (0x4802, 0x6801, 0x3101, 0x6001, 0x4770, 0xBF00)
# ldr r0, =20000; subs r0, #1; bne .-2; bx lr
SLOW = (0x4801, 0x3801, 0xD1FD, 0x4770, 20000, 0)
RCC, TIM2, TIM3, TIM8, DMA2, USART2, FLASH, NVIC, SYSCFG, EXTI, IWDG, PWR = (
    0x4002_3800, 0x4000_0000, 0x4000_0400, 0x4001_0400, 0x4002_6400, 0x4000_4400, 0x4002_3C00, 0xE000_E000, 0x4001_3800,
    0x4001_3C00, 0x4000_3000, 0x4000_7000)
RING, SILENCE = RAM + 0x1000, RAM + 0x2000
QUIET = 0xE0E0_0000


def board(main=ASLEEP, handlers=None, **options):
    """A board with a program: `main` and handlers by exception number, as halfwords. All clocks on, 16 MHz."""
    table, code = [0] * 98, b""
    base = 0x0800_0200

    def place(halfwords):
        nonlocal code
        address = base + len(code)
        code += struct.pack(f"<{len(halfwords)}H", *halfwords) + b"\0\0" * (len(halfwords) % 2)
        return address | 1
    table[0], table[1] = 0x1001_0000, place(main)
    for number, halfwords in (handlers or {}).items():
        table[number] = place(halfwords)
    b = Board(Image.of_bytes([(0x0800_0000, struct.pack("<98I", *table)), (base, code)]), **options)
    b.core.sram[:0x3000] = bytes(0x3000)
    for enable in (0x30, 0x34, 0x40, 0x44):
        b.bus.store(RCC + enable, 0xFFFF_FFFF)
    return b


def counter(index):
    """A handler that counts its calls in word `index` of RAM."""
    return COUNTER + (4 * index, RAM >> 16)


def word(b, address):
    return struct.unpack_from("<I", b.core.sram, address - RAM)[0]


def enable(b, irq, priority):
    b.bus.store(NVIC + 0x400 + irq, priority, 1)
    b.bus.store(NVIC + 0x100 + 4 * (irq // 32), 1 << irq % 32)


def full_speed(b):
    """168 MHz from the crystal."""
    b.bus.store(RCC, 0x1_0083)
    b.run(3000)
    b.bus.store(RCC + 4, 4 | 168 << 6 | 0 << 16 | 1 << 22 | 7 << 24)
    b.bus.store(RCC, 0x101_0083)
    b.run(300)
    b.bus.store(RCC + 8, 2 | 5 << 10 | 4 << 13)


# Clocks and time.

def test_the_crystal_is_ready_after_two_milliseconds_and_a_dead_one_never():
    good, dead = board(), board(crystal="dead")
    for b in (good, dead):
        b.bus.store(RCC, 0x1_0083)
        b.run(1900)
        assert not b.bus.load(RCC) >> 17 & 1
        b.run(200)
    assert good.bus.load(RCC) >> 17 & 1
    dead.run(1_000_000)
    assert not dead.bus.load(RCC) >> 17 & 1


def test_instructions_take_one_and_a_half_cycles_of_the_clock_that_is_chosen():
    b = board(main=(0xE7FE,))
    b.run(1000)
    assert b.core.state.count == pytest.approx(16_000 / 1.5, abs=2)
    full_speed(b)
    before = b.core.state.count
    b.run(1000)
    assert b.core.state.count - before == pytest.approx(168_000 / 1.5, abs=2)


def test_a_crystal_that_dies_under_guard_gives_the_nmi_and_the_internal_clock():
    # the NMI handler counts and clears the flag of CSS: ldr r0, =CIR; ldr r1, =1<<23; str r1, [r0]; bx lr
    b = board(handlers={NMI: (0x4802, 0x4903, 0x6001, 0x4770, 0xBF00, 0xBF00, 0x380C, 0x4002, 0, 0x80)})
    full_speed(b)
    b.bus.store(RCC, b.bus.load(RCC) | 1 << 19)
    assert b.rcc.system_hz == 168_000_000
    b.kill_crystal()
    b.run(100)
    assert b.stats.entries[NMI] == 1
    assert b.rcc.system_hz == 16_000_000


def test_without_guard_a_dying_crystal_stops_the_chip_until_the_watchdog_bites():
    b = board(main=(0xE7FE,))
    full_speed(b)
    b.bus.store(IWDG, 0xCCCC)
    b.kill_crystal()
    before = b.core.state.count
    b.run(100_000)
    assert b.core.state.count == before
    b.run(500_000)
    assert b.resets[-1][1] == "watchdog"
    assert b.bus.load(RCC + 0x74) >> 29 & 1


def test_the_same_run_twice_is_the_same_run():
    def fingerprint():
        b = streaming(board(handlers={16 + 28: counter(0), 16 + 29: counter(1)}))
        enable(b, 28, 0x10)
        b.bus.store(TIM2 + 0x0C, 2)
        b.bus.store(TIM2 + 0x34, 77)
        b.at(123.4, lambda: b.pin("A", 0, 0))
        b.run(5000)
        return b.core.state.count, b.machine.now, len(b.words), b.words.runs
    assert fingerprint() == fingerprint()


# The core.

def test_code_behind_an_it_block_is_unconditional():
    # movs r0,#1; movs r2,#0; cmp r0,#1; itt eq; moveq r1,#5; cmpeq r0,#2; b .+2; movs r2,#7; ldr r3,=RAM; stm r3!,{r1,r2}; wfi; b .-2
    main = (0x2001, 0x2200, 0x2801, 0xBF04, 0x2105, 0x2802, 0xE7FF, 0x2207, 0x4B01, 0xC306, 0xBF30, 0xE7FD, 0x0000, 0x2000)
    b = board(main=main)
    b.run(100)
    assert (word(b, RAM), word(b, RAM + 4)) == (5, 7)


def test_an_interrupt_wakes_the_sleeping_core_and_returns():
    b = board(handlers={16 + 29: counter(0)})
    enable(b, 29, 0x80)
    b.bus.store(TIM3 + 0x28, 15)
    b.bus.store(TIM3 + 0x2C, 99)
    b.bus.store(TIM3 + 0x14, 1)
    b.bus.store(TIM3 + 0x10, 0)
    b.bus.store(TIM3 + 0x0C, 1)
    b.bus.store(TIM3 + 0x00, 1)
    b.run(99)
    assert word(b, RAM) == 0
    b.run(5)
    assert word(b, RAM) > 0, "the flag stands: the handler runs again and again"
    b.bus.store(TIM3 + 0x10, 0)
    b.bus.store(TIM3 + 0x0C, 0)
    before = word(b, RAM)
    b.run(1000)
    assert word(b, RAM) <= before + 1
    assert not b.nvic.active


def test_a_more_urgent_interrupt_interrupts_a_handler_and_an_equal_one_waits():
    b = board(handlers={16 + 1: SLOW, 16 + 2: counter(0), 16 + 3: counter(1)})
    for irq, priority in ((1, 0x40), (2, 0x30), (3, 0x40)):
        enable(b, irq, priority)
    b.bus.store(NVIC + 0x200, 0b1110)
    b.run(100)
    assert word(b, RAM) == 1, "the more urgent one came first"
    assert b.nvic.active == [17]
    b.bus.store(NVIC + 0x200, 0b0100)
    b.run(10)
    assert word(b, RAM) == 2 and word(b, RAM + 4) == 0 and b.nvic.active == [17]
    b.run(10_000)
    assert word(b, RAM + 4) == 1 and not b.nvic.active


def test_basepri_masks_what_is_less_urgent_and_its_release_lets_it_in_at_once():
    # movs r0,#0x20; msr basepri,r0; ldr r1,=20000; subs r1,#1; bne .-2; movs r0,#0; msr basepri,r0; wfi; b .-2
    main = (0x2020, 0xF380, 0x8811, 0x4904, 0x3901, 0xD1FD, 0x2000, 0xF380, 0x8811, 0xBF30, 0xE7FD, 0xBF00, 20000, 0)
    b = board(main=main, handlers={16 + 1: counter(0), 16 + 2: counter(1)})
    enable(b, 1, 0x10)
    enable(b, 2, 0x20)
    b.run(100)
    b.bus.store(NVIC + 0x200, 0b110)
    b.run(100)
    assert word(b, RAM) == 1 and word(b, RAM + 4) == 0
    b.run(10_000)
    assert word(b, RAM + 4) == 1
    (us, times, _), = b.longest_masked()
    assert times == 1 and us == pytest.approx(40_001 * 1.5 / 16, rel=0.01)


def test_a_load_from_nowhere_is_a_hard_fault_and_one_in_its_handler_locks_up():
    # ldr r0, =0x30000000; ldr r0, [r0]
    bad = (0x4801, 0x6800, 0xE7FE, 0xBF00, 0x0000, 0x3000)
    b = board(main=bad, handlers={HARD_FAULT: counter(0)})
    b.run(1)
    assert b.stats.entries[HARD_FAULT] > 0 and b.stats.faults[0][2] == 0x3000_0000
    b = board(main=bad, handlers={HARD_FAULT: bad})
    b.run(10)
    assert b.machine.locked_up


def test_a_stack_that_runs_over_its_end_is_a_hard_fault():
    b = board(main=(0xB580, 0xE7FD), handlers={HARD_FAULT: (0xE7FE,)})  # push {r7, lr}; b .-2
    b.run(20_000)
    assert b.stats.entries[HARD_FAULT] == 1 and b.core.sp < 0x1000_0000
    assert b.stack_used() == 0x1_0000


def test_a_program_counter_led_astray_ends_in_the_hard_fault_handler():
    b = board(handlers={HARD_FAULT: (0xE7FE,)})
    b.run(10)
    b.hard_fault()
    b.run(10)
    assert b.nvic.active == [HARD_FAULT]


def test_blocked_interrupts_come_late_and_are_not_lost():
    b = board(handlers={16 + 1: counter(0)})
    enable(b, 1, 0)
    b.mask_interrupts(500)
    b.bus.store(NVIC + 0x200, 2)
    b.run(499)
    assert word(b, RAM) == 0
    b.run(5)
    assert word(b, RAM) == 1


# The stream.

def streaming(b, count=512, start=True):
    """TIM8, both streams and TIM2 as the firmware uses them; word n of the ring sets the low half to n."""
    full_speed(b)
    b.bus.store(0x4002_0000, 0xA800_0000 | 2)
    b.bus.store(0x4002_0020, 3)
    b.pin("A", 0, 1)
    for i in range(count):
        struct.pack_into("<I", b.core.sram, RING - RAM + 4 * i, i)
    struct.pack_into("<I", b.core.sram, SILENCE - RAM, QUIET)
    for offset, value in ((0x2C, 167), (0x34, 84), (0x04, 0x20), (0x08, 0x75), (0x14, 1), (0x10, 0), (0x0C, 1 << 8 | 1 << 9 | 1 << 6)):
        b.bus.store(TIM8 + offset, value)
    for offset, value in ((0x08, 0x17), (0x14, 1), (0x10, 0), (0x00, 1)):
        b.bus.store(TIM2 + offset, value)
    b.run(1)
    b.bus.store(TIM8 + 0x10, 0)
    base = 7 << 25 | 2 << 13 | 2 << 11 | 1 << 10 | 1 << 8
    b.bus.store(DMA2 + 0x40 + 8, SILENCE)
    b.bus.store(DMA2 + 0x40 + 12, RING)
    b.bus.store(DMA2 + 0x40 + 4, count)
    b.bus.store(DMA2 + 0x40, base | 1)
    for _ in range(count - count // 4):
        b.bus.store(TIM8 + 0x14, 2)
        b.run(0.2)
    b.bus.store(DMA2 + 0x28 + 8, 0x4002_1018)
    b.bus.store(DMA2 + 0x28 + 12, RING)
    b.bus.store(DMA2 + 0x28 + 4, count)
    for i in range(count):
        struct.pack_into("<I", b.core.sram, RING - RAM + 4 * i, i)
    b.bus.store(DMA2 + 0x28, base | 1 << 6 | 1)
    if start:
        b.bus.store(TIM8, 1)
    return b


def test_the_ring_plays_a_word_a_microsecond_and_nothing_plays_twice():
    b = streaming(board())
    assert b.merged_requests == 0
    b.run(1000.5)
    # the segment behind the first word is cleared while the first segment plays: three are played, then silence
    assert list(b.words.slice(0, 384)) == list(range(384))
    assert set(b.words.slice(384)) == {QUIET}
    assert len(b.words) == 1000
    assert b.words.time_us(999) - b.words.time_us(0) == pytest.approx(999)
    assert b.bus.load(TIM2 + 0x24) == 1000
    assert b.bus.load(DMA2 + 0x28 + 4) == 512 - 1000 % 512


def test_a_word_written_before_its_tick_plays_and_one_written_with_it_does_not():
    b = streaming(board())
    b.run_ticks(300, 1000)
    for slot in (300, 301, 302):
        struct.pack_into("<I", b.core.sram, RING - RAM + 4 * slot, 0xABCD)
    b.run_ticks(5, 100)
    # word 300 had been read ahead when word 299 played
    assert list(b.words.slice(299, 304)) == [299, 300, 0xABCD, 0xABCD, 303]


def test_the_program_writes_the_ring_in_step_with_the_stream():
    # for ever: ldr r0, =ring; ldr r1, =512; str r2, [r0]; adds r0, #4; subs r1, #1; bne; adds r2, #1; b
    main = (0x2200, 0x4804, 0x4904, 0x6002, 0x3004, 0x3901, 0xD1FB, 0x3201, 0xE7F7, 0xBF00, 0x1000, 0x2000, 512, 0)
    b = streaming(board(main=main))
    b.run(2000)
    seen = b.words.slice(600)
    # each pass of the program takes 4 instructions a word: 1.5 * 4 * 512 / 168 us = 18.3 us
    passes = [w for w in seen if w != QUIET]
    assert len(passes) == len(seen), "the program overtakes what clears"
    rises = (passes[-1] - passes[0]) / (len(passes) - 1)
    assert rises == pytest.approx(1 / 18.3, rel=0.03)


def test_the_gate_stops_the_words_by_hardware_and_counts_them_exactly():
    b = streaming(board(handlers={16 + 45: counter(0)}))
    enable(b, 45, 0)
    b.run_ticks(200, 1000)
    b.pin("A", 0, 0)
    b.run(1000)
    assert len(b.words) == 200
    assert b.bus.load(TIM2 + 0x24) == 200 and b.bus.load(DMA2 + 0x2C) == 312
    assert word(b, RAM) > 0
    b.pin("A", 0, 1)
    b.run(100)
    assert len(b.words) in (299, 300)
    assert len(b.words.runs) == 2


def test_a_gate_pin_without_its_alternate_function_reads_low():
    b = streaming(board(), start=False)
    b.bus.store(0x4002_0000, 0xA800_0000)
    b.bus.store(TIM8, 1)
    b.run(100)
    assert len(b.words) == 0


def test_the_counter_of_ticks_interrupts_at_the_border_at_once():
    b = streaming(board(handlers={16 + 28: counter(0)}), start=False)
    enable(b, 28, 0x10)
    b.bus.store(TIM2 + 0x34, 128)
    b.bus.store(TIM2 + 0x0C, 2)
    b.bus.store(TIM8, 1)
    b.run(127.9)
    assert word(b, RAM) == 0
    b.run(0.5)
    assert word(b, RAM) >= 1
    assert 0 < min(b.stats.refill_latency_us) < 0.2, "twelve cycles of stacking"


def test_a_transfer_error_ends_the_stream_and_raises_its_interrupt():
    b = streaming(board(handlers={16 + 57: counter(0)}))
    b.bus.store(DMA2 + 0x28, b.bus.load(DMA2 + 0x28) | 4)
    enable(b, 57, 0)
    b.run_ticks(100, 1000)
    b.dma_error(1)
    b.run(100)
    assert len(b.words) == 100 and word(b, RAM) > 0
    assert b.bus.load(DMA2) >> 9 & 1 and not b.bus.load(DMA2 + 0x28) & 1


def test_a_stream_into_core_coupled_memory_is_a_transfer_error():
    b = board()
    b.bus.store(DMA2 + 0x28 + 8, 0x4002_1018)
    b.bus.store(DMA2 + 0x28 + 12, 0x1000_0000)
    b.bus.store(DMA2 + 0x28 + 4, 8)
    b.bus.store(DMA2 + 0x28, 7 << 25 | 2 << 13 | 2 << 11 | 1 << 10 | 1 << 6 | 1)
    assert b.bus.load(DMA2) >> 9 & 1 and not b.bus.load(DMA2 + 0x28) & 1


def test_software_events_faster_than_the_dma_are_lost():
    b = streaming(board(), start=False)
    before = b.bus.load(DMA2 + 0x44)
    for _ in range(10):
        b.bus.store(TIM8 + 0x14, 2)
    assert before - b.bus.load(DMA2 + 0x44) == 1 and b.merged_requests == 9


@pytest.mark.parametrize("freeze", [True, False])
def test_a_halted_core_stops_the_stream_only_where_dbgmcu_says_so(freeze):
    b = streaming(board())
    b.bus.store(0xE004_200C, 2 if freeze else 0)
    b.run_ticks(100, 1000)
    b.halt_core(2000)
    b.run(1000)
    assert len(b.words) == (100 if freeze else 1100)
    b.run(1100)
    assert len(b.words) == pytest.approx(200 if freeze else 2200, abs=1)


def test_disabling_a_stream_takes_a_moment_and_sets_its_flag():
    b = streaming(board())
    b.run(10)
    b.bus.store(DMA2 + 0x28, b.bus.load(DMA2 + 0x28) & ~1)
    assert b.bus.load(DMA2 + 0x28) & 1
    b.run(1)
    assert not b.bus.load(DMA2 + 0x28) & 1 and b.bus.load(DMA2) >> 11 & 1


def test_steps_are_decoded_from_rising_edges_with_their_direction():
    b = streaming(board(), start=False)
    step, direction = 1 << 6, 1 << 4
    for i, w in enumerate((direction, QUIET, step | QUIET, QUIET, direction << 16, step | QUIET, step, QUIET)):
        struct.pack_into("<I", b.core.sram, RING - RAM + 4 * i, w)
    for i in range(8, 512):
        struct.pack_into("<I", b.core.sram, RING - RAM + 4 * i, QUIET)
    b.bus.store(DMA2 + 0x28, b.bus.load(DMA2 + 0x28) & ~1)
    b.run(1)
    b.bus.store(DMA2 + 8, 0x3D << 6)
    b.bus.store(DMA2 + 0x2C, 512)
    b.bus.store(DMA2 + 0x28, b.bus.load(DMA2 + 0x28) | 1)
    b.bus.store(TIM8, 1)
    b.run(400)
    assert b.words.steps() == [(2, 0, 1), (5, 0, -1)]
    assert b.words.position() == [0] * 6
    assert b.level("E", 6) == 0 and b.level("E", 4) == 0


# Ports.

def test_pins_follow_drive_pull_and_output():
    b = board()
    b.bus.store(0x4002_0C0C, 1 << 2 | 2 << 4)  # PD1 up, PD2 down
    assert b.bus.load(0x4002_0C10) & 6 == 2
    b.pin("D", 1, 0)
    b.pin("D", 2, 1)
    assert b.bus.load(0x4002_0C10) & 6 == 4
    b.pin("D", 1, None)
    assert b.bus.load(0x4002_0C10) & 6 == 6
    b.bus.store(0x4002_0C00, 1 << 6)  # PD3 an output
    b.bus.store(0x4002_0C18, 8)
    assert b.level("D", 3) == 1


def test_edges_of_the_chosen_port_interrupt():
    b = board(handlers={16 + 23: counter(0)})
    enable(b, 23, 0)
    b.bus.store(SYSCFG + 12, 3 << 4)  # line 5 from port D
    b.bus.store(EXTI + 8, 1 << 5)
    b.bus.store(EXTI, 1 << 5)
    b.pin("A", 5, 1)
    b.run(10)
    assert word(b, RAM) == 0
    b.pin("D", 5, 1)
    b.run(5)
    assert word(b, RAM) > 0 and b.bus.load(EXTI + 20) == 1 << 5
    b.bus.store(EXTI + 20, 1 << 5)
    assert b.bus.load(EXTI + 20) == 0


# Serial.

def uart(b, baud=115_200):
    b.bus.store(USART2 + 8, round(16_000_000 / baud))
    b.bus.store(USART2 + 12, 0x200C)
    return b


def test_bytes_arrive_at_the_speed_of_the_wire():
    b = uart(board())
    b.serial.write(b"U")
    b.run(86)
    assert not b.bus.load(USART2) & 0x20
    b.run(1)
    assert b.bus.load(USART2) & 0x20 and b.bus.load(USART2 + 4) == 0x55
    b.run(80)
    assert not b.bus.load(USART2) & 0x10
    b.run(10)
    assert b.bus.load(USART2) & 0x10, "the line has idled for a frame"
    b.bus.load(USART2 + 4)
    assert not b.bus.load(USART2) & 0x10


def test_a_byte_that_nobody_fetched_is_overrun():
    b = uart(board())
    b.serial.write(b"AB")
    b.run(300)
    assert b.bus.load(USART2) & 0x28 == 0x28 and b.bus.load(USART2 + 4) == ord("A")
    assert b.bus.load(USART2) & 0x28 == 0 and b.usart2.lost == 1


def test_a_break_is_one_broken_zero_and_a_low_line():
    b = uart(board())
    b.serial.send_break(1000)
    b.run(500)
    assert b.bus.load(USART2) & 0x22 == 0x22 and b.bus.load(USART2 + 4) == 0
    assert not b.bus.load(0x4002_0010) & 8
    b.run(600)
    assert b.bus.load(0x4002_0010) & 8 and not b.bus.load(USART2) & 0x20


def test_the_wrong_baud_rate_gives_framing_errors():
    b = uart(board(), baud=57_600)
    b.serial.write(b"A")
    b.run(300)
    assert b.bus.load(USART2) & 2 and b.bus.load(USART2 + 4) != ord("A")


def test_sent_bytes_take_their_time():
    b = uart(board())
    b.bus.store(USART2 + 4, ord("x"), 1)
    assert not b.bus.load(USART2) & 0x40 and b.bus.load(USART2) & 0x80
    b.run(86)
    assert b.serial.read() == b""
    b.run(2)
    assert b.serial.read() == b"x" and b.bus.load(USART2) & 0x40


# Memory that stays.

def unlock(b, cr):
    b.bus.store(FLASH + 4, 0x4567_0123)
    b.bus.store(FLASH + 4, 0xCDEF_89AB)
    b.bus.store(FLASH + 16, cr)


# ldr r0, =0x08004000; ldr r1, =0x12345678; str r1, [r0]; wfi; b .-2
WRITES = (0x4803, 0x4904, 0x6001, 0xBF30, 0xE7FD, 0xBF00, 0xBF00, 0xBF00, 0x4000, 0x0800, 0x5678, 0x1234)


def test_programming_clears_bits_and_takes_its_time():
    b = board(main=WRITES)
    b.core.flash[0x4000:0x4004] = b"\xff\xff\x00\xff"
    unlock(b, 0x201)
    b.run(10)
    assert bytes(b.core.flash[0x4000:0x4004]) == b"\x78\x56\x00\x12"
    assert b.machine.frozen_until > b.machine.now
    assert b.flash.log == [(0, "program", 0x0800_4000)]


def test_a_locked_flash_keeps_its_content_and_says_so():
    b = board(main=WRITES)
    b.run(10)
    assert bytes(b.core.flash[0x4000:0x4004]) == b"\xff" * 4
    assert b.bus.load(FLASH + 12) & 0x80


def test_an_erase_stalls_the_core_and_its_interrupts_but_not_the_stream():
    b = streaming(board(handlers={16 + 1: counter(0)}))
    enable(b, 1, 0)
    b.core.flash[0x8000:0x8004] = b"abcd"
    unlock(b, 1 << 1 | 2 << 3 | 1 << 16)
    b.run(1)
    assert bytes(b.core.flash[0x8000:0x8004]) == b"\xff" * 4
    b.bus.store(NVIC + 0x200, 2)
    b.run(399_000)
    assert word(b, RAM) == 0
    b.run(2000)
    assert word(b, RAM) == 1
    assert len(b.words) == pytest.approx(401_001, abs=1)


def test_a_power_cut_leaves_an_erase_half_done_and_flash_survives_it():
    b = board()
    b.core.flash[0x4000:0x8000] = bytes(0x4000)
    b.flash.cut_at = 0
    unlock(b, 1 << 1 | 1 << 3 | 1 << 16)
    with pytest.raises(PowerCut):
        b.run(10)
    half = bytes(b.core.flash[0x4000:0x8000])
    ones = sum(byte.bit_count() for byte in half)
    assert 0.4 < ones / (8 * 0x4000) < 0.6
    b.power_cycle()
    assert bytes(b.core.flash[0x4000:0x8000]) == half
    b.run(10)


def test_a_failing_operation_sets_its_flag_and_changes_nothing():
    b = board(main=WRITES)
    b.flash.fail_at = 0
    unlock(b, 0x201)
    b.run(10)
    assert b.bus.load(FLASH + 12) & 0x10 and bytes(b.core.flash[0x4000:0x4004]) == b"\xff" * 4


@pytest.mark.parametrize("vbat", [True, False])
def test_backup_memory_survives_a_reset_and_a_power_cut_only_with_a_battery(vbat):
    b = board(vbat=vbat)
    b.bus.store(0x4002_4000, 1)
    assert b.bus.load(0x4002_4000) != 1, "closed until PWR says otherwise"
    b.bus.store(PWR, 1 << 8)
    b.bus.store(0x4002_4000, 0x1234_5678)
    b.reset()
    b.bus.store(RCC + 0x30, 0xFFFF_FFFF)
    assert b.bus.load(0x4002_4000) == 0x1234_5678
    b.power_cycle()
    b.bus.store(RCC + 0x30, 0xFFFF_FFFF)
    assert (b.bus.load(0x4002_4000) == 0x1234_5678) is vbat


def test_reset_causes_are_told_apart_until_they_are_cleared():
    b = board()
    assert b.bus.load(RCC + 0x74) >> 24 == 0b1110, "power on: POR, PIN, BOR"
    b.bus.store(RCC + 0x74, 1 << 24)
    b.reset()
    assert b.bus.load(RCC + 0x74) >> 24 == 0b100
    b.bus.store(NVIC + 0xD0C, 0x05FA_0004)
    b.run(1)
    assert b.bus.load(RCC + 0x74) >> 24 == 0b1_0100


def test_the_watchdog_bites_when_it_is_not_fed():
    b = board()
    b.bus.store(IWDG, 0x5555)
    b.bus.store(IWDG + 4, 0)
    b.bus.store(IWDG + 8, 799)
    b.bus.store(IWDG, 0xCCCC)
    for _ in range(5):
        b.run(90_000)
        b.bus.store(IWDG, 0xAAAA)
    assert len(b.resets) == 1
    b.run(99_900)
    assert len(b.resets) == 1
    b.run(200)
    assert b.resets[-1][1] == "watchdog" and b.bus.load(RCC + 0x74) >> 29 & 1


def test_a_peripheral_without_its_clock_does_not_answer():
    b = board()
    b.bus.store(RCC + 0x40, 0)
    b.bus.store(TIM3 + 0x2C, 5)
    assert b.bus.load(TIM3 + 0x2C) == 0 and len(b.bus.warnings) == 2


@pytest.mark.parametrize("words_per_pass", [512, 64])
def test_looking_after_the_streams_rarely_gives_the_same_words_as_looking_always(monkeypatch, words_per_pass):
    main = (0x2200, 0x4804, 0x4904, 0x6002, 0x3004, 0x3901, 0xD1FB, 0x3201, 0xE7F7, 0xBF00, 0x1000, 0x2000, words_per_pass, 0)

    def play():
        b = streaming(board(main=main))
        b.run(3000)
        return b.words.slice().tobytes()
    rarely = play()
    monkeypatch.setattr("stm32f4.timers._LOOK_TICKS", 0)
    assert play() == rarely


@pytest.mark.parametrize("resumes", [False, True])
def test_a_stream_enabled_again_begins_at_its_address_unless_told_otherwise(resumes):
    b = streaming(board())
    b.dma_resumes = resumes
    b.run_ticks(100, 1000)
    b.bus.store(TIM8, 0)
    cr = b.bus.load(DMA2 + 0x28)
    b.bus.store(DMA2 + 0x28, cr & ~1)
    b.run(1)
    b.bus.store(DMA2 + 8, 0x3D << 6)
    b.bus.store(DMA2 + 0x28, cr)
    assert b.bus.load(DMA2 + 0x2C) == 412
    b.bus.store(TIM8, 1)
    b.run(50)
    assert b.words[102] == (102 if resumes else 2)


def test_a_reset_ends_the_stream_after_the_words_that_have_played():
    b = streaming(board())
    b.run_ticks(300, 1000)
    b.at(10.5, b.reset)
    b.run(1000)
    assert len(b.words) == 310
    assert b.resets[-1][1] == "pin"
