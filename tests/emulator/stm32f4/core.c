/* What the emulator must do at every instruction and at every exception, where Python would be too slow.
 *
 * Built by core.py with the system's C compiler and given to Unicorn as hooks; Unicorn's own functions come in as pointers,
 * so nothing is linked. Nothing here knows a peripheral. */
#include <stddef.h>
#include <stdint.h>

/* Numbers of Unicorn's registers, handed in by core.py (they are not part of a stable interface). */
enum { R_R0, R_R1, R_R2, R_R3, R_R12, R_LR, R_SP, R_XPSR, R_CONTROL, R_FPSCR, R_S0, R_BASEPRI, R_PRIMASK, R_COUNT };

enum { STOP_NONE, STOP_LIMIT, STOP_WFE, STOP_WFI, STOP_EXCEPTION };

#define SECTIONS 64
#define LATE 256

struct section { /* one place where interrupts are masked */
    uint32_t pc, end_pc;
    uint64_t longest, times;
};

struct core {
    uint64_t count;       /* instructions executed since the machine was made */
    uint64_t limit;       /* stop before the instruction that would make count exceed this */
    uint64_t store_sync;  /* from this count on every store into the ring calls on_store */
    uint32_t last_pc;     /* the instruction in flight, or the one not yet executed after a stop */
    uint32_t reason;      /* STOP_ */
    uint32_t exception;   /* Unicorn's number of it */
    uint32_t event;       /* the event register of WFE */
    uint32_t it_start, it_end; /* the IT block seen last: never stop inside */
    uint32_t watch_masks; /* an interrupt waits behind a mask: stop after each instruction that may lift one */
    /* Until then, only stores into the two windows of the ring that the streams may have reached (bytes from its start). */
    uint32_t ring_base, ring_size, window[2], window_size;
    uint32_t flash_base, flash_size; /* stores into it call on_store always */
    const uint16_t *flash;
    int (*emu_stop)(void *);
    int (*reg_read)(void *, int, void *);
    int (*reg_write)(void *, int, const void *);
    int (*mem_read)(void *, uint64_t, void *, uint64_t);
    int (*mem_write)(void *, uint64_t, const void *, uint64_t);
    void (*on_store)(uint32_t address, uint32_t size, uint32_t value);
    int32_t reg[R_COUNT];
    /* Masks as last written, and the sections between raising and releasing them. */
    uint32_t basepri, primask, faultmask;
    uint64_t section_start, excluded, preempted_at; /* handlers that interrupt a section do not belong to it */
    uint32_t section_pc, section_depth, depth;
    uint32_t sections_used;
    struct section sections[SECTIONS];
    /* Instructions at each address, when profiling is on (one counter per halfword of flash). */
    uint32_t *profile;
};

static void section_change(struct core *c, uint32_t pc, uint32_t was, uint32_t is) {
    if (!was && is) {
        c->section_start = c->count;
        c->section_pc = pc;
        c->section_depth = c->depth;
        c->excluded = 0;
    } else if (was && !is) {
        uint64_t length = c->count - c->section_start - c->excluded;
        uint32_t i;
        for (i = 0; i < c->sections_used && c->sections[i].pc != c->section_pc; i++) {}
        if (i == c->sections_used) {
            if (i == SECTIONS) return;
            c->sections_used++;
            c->sections[i] = (struct section){c->section_pc, pc, 0, 0};
        }
        c->sections[i].times++;
        if (length > c->sections[i].longest) { c->sections[i].longest = length; c->sections[i].end_pc = pc; }
    }
}

static void masks_written(void *uc, struct core *c, uint32_t pc, uint32_t op, uint32_t op2) {
    uint32_t was = c->basepri | c->primask | c->faultmask;
    if ((op & 0xffec) == 0xb660) { /* CPSIE, CPSID */
        uint32_t set = op >> 4 & 1;
        if (op & 2) c->primask = set;
        if (op & 1) c->faultmask = set;
    } else { /* MSR */
        static const uint8_t order[16] = {R_R0, R_R1, R_R2, R_R3, 0, 0, 0, 0, 0, 0, 0, 0, R_R12, 0, R_LR, 0};
        uint32_t n = op & 15, value = 0;
        int id = (n < 4 || n == 12 || n == 14) ? c->reg[order[n]] : c->reg[R_R0] + (int)n;
        c->reg_read(uc, id, &value);
        switch (op2 & 0xff) {
        case 16: c->primask = value & 1; break;
        case 17: c->basepri = value & 0xf0; break;
        case 18: value &= 0xf0; if (value && (!c->basepri || value < c->basepri)) c->basepri = value; break;
        case 19: c->faultmask = value & 1; break;
        default: return;
        }
    }
    section_change(c, pc, was, c->basepri | c->primask | c->faultmask);
    if (c->watch_masks) c->limit = c->count; /* this instruction has been counted: stop before the next one */
}

/* Unicorn 2.1 notes the state of an IT block before it calls a hook inside, and leaves it standing after the block: the
 * code that follows would become conditional. What it has noted is taken back here; it knows the state by itself. */
static void clear_it_state(void *uc, struct core *c) {
    uint32_t xpsr = 0;
    c->reg_read(uc, c->reg[R_XPSR], &xpsr);
    xpsr &= ~0x0600fc00u;
    c->reg_write(uc, c->reg[R_XPSR], &xpsr);
}

static void note_it_block(struct core *c, uint32_t pc, uint32_t op) {
    uint32_t left = 4 - (uint32_t)__builtin_ctz(op & 15);
    c->it_start = c->it_end = pc + 2;
    while (left--) c->it_end += c->flash[(c->it_end - c->flash_base) >> 1] >> 11 >= 0x1d ? 4 : 2;
}

void code_hook(void *uc, uint64_t address, uint32_t size, struct core *c) {
    uint32_t pc = (uint32_t)address;
    (void)size;
    c->last_pc = pc;
    if (pc - c->it_start < c->it_end - c->it_start) {
        clear_it_state(uc, c);
    } else if (c->count >= c->limit) {
        c->reason = STOP_LIMIT;
        c->emu_stop(uc);
        return;
    }
    uint32_t offset = pc - c->flash_base;
    if (offset < c->flash_size) {
        uint32_t op = c->flash[offset >> 1];
        if (c->profile) c->profile[offset >> 1]++;
        switch (op >> 8) {
        case 0xbf:
            if (op & 15) { /* IT */
                note_it_block(c, pc, op);
            } else if (op == 0xbf20) {
                c->reason = STOP_WFE;
                c->emu_stop(uc);
                return;
            } else if (op == 0xbf30) {
                c->reason = STOP_WFI;
                c->emu_stop(uc);
                return;
            } else if (op == 0xbf40) {
                c->event = 1;
            }
            break;
        case 0xb6:
            if ((op & 0xffec) == 0xb660) { c->count++; masks_written(uc, c, pc, op, 0); return; }
            break;
        case 0xf3:
            if ((op & 0xfff0) == 0xf380 && (c->flash[(offset >> 1) + 1] & 0xff00) == 0x8800) {
                c->count++;
                masks_written(uc, c, pc, op, c->flash[(offset >> 1) + 1]);
                return;
            }
            break;
        }
    }
    c->count++;
}

static int in_window(const struct core *c, uint32_t offset, uint32_t window) {
    return (offset >= window ? offset - window : offset + c->ring_size - window) < c->window_size;
}

void store_hook(void *uc, int type, uint64_t address, int size, int64_t value, struct core *c) {
    uint32_t a = (uint32_t)address, offset = a - c->ring_base;
    (void)uc; (void)type;
    if (offset < c->ring_size) {
        if (c->count < c->store_sync && !in_window(c, offset, c->window[0]) && !in_window(c, offset, c->window[1])) return;
    } else if (a - c->flash_base >= c->flash_size) {
        return;
    }
    c->on_store(a, (uint32_t)size, (uint32_t)value);
}

void exception_hook(void *uc, uint32_t number, struct core *c) {
    c->reason = STOP_EXCEPTION;
    c->exception = number;
    c->emu_stop(uc);
}

static uint32_t get(void *uc, struct core *c, int which) {
    uint32_t value = 0;
    c->reg_read(uc, c->reg[which], &value);
    return value;
}

static void set(void *uc, struct core *c, int which, uint32_t value) { c->reg_write(uc, c->reg[which], &value); }

/* Pushes the frame of an exception (ARMv7-M, B1.5.6) with the return address `pc` and enters handler mode as `number`.
 * Answers 0, or 1 if the stack could not be written; the core is in the handler either way. */
int exception_enter(void *uc, struct core *c, uint32_t pc, uint32_t number, uint32_t from_handler) {
    uint32_t frame[26], control = get(uc, c, R_CONTROL), fp = control >> 2 & 1, xpsr = get(uc, c, R_XPSR);
    uint32_t sp = get(uc, c, R_SP), words = fp ? 26 : 8, base = (sp - 4 * words) & ~7u;
    for (int i = 0; i < 6; i++) frame[i] = get(uc, c, R_R0 + i);
    frame[6] = pc;
    frame[7] = (xpsr & ~(1u << 9)) | 1u << 24 | ((sp & 4) ? 1u << 9 : 0);
    if (fp) {
        for (int i = 0; i < 16; i++) c->reg_read(uc, c->reg[R_S0] + i, &frame[8 + i]);
        frame[24] = get(uc, c, R_FPSCR);
        frame[25] = 0;
        set(uc, c, R_CONTROL, control & ~4u);
    }
    if (c->depth++ == c->section_depth) c->preempted_at = c->count;
    int failed = c->mem_write(uc, base, frame, 4 * words) != 0;
    set(uc, c, R_SP, base);
    set(uc, c, R_LR, (from_handler ? 0xfffffff1u : 0xfffffff9u) & ~(fp << 4));
    set(uc, c, R_XPSR, 1u << 24 | number);
    return failed;
}

/* Pops the frame that `exc_return` names; answers the return address, or 1 if the stack could not be read. */
uint32_t exception_leave(void *uc, struct core *c, uint32_t exc_return) {
    uint32_t frame[26], sp = get(uc, c, R_SP), fp = !(exc_return >> 4 & 1), words = fp ? 26 : 8;
    if (c->depth && --c->depth == c->section_depth) c->excluded += c->count - c->preempted_at;
    if (c->mem_read(uc, sp, frame, 4 * words)) return 1;
    for (int i = 0; i < 6; i++) set(uc, c, R_R0 + i, frame[i]);
    uint32_t control = get(uc, c, R_CONTROL) & ~4u;
    if (fp) {
        for (int i = 0; i < 16; i++) c->reg_write(uc, c->reg[R_S0] + i, &frame[8 + i]);
        set(uc, c, R_FPSCR, frame[24]);
        control |= 4;
    }
    set(uc, c, R_CONTROL, control);
    set(uc, c, R_SP, sp + 4 * words + (frame[7] >> 9 & 1) * 4);
    set(uc, c, R_XPSR, frame[7] & ~(1u << 9));
    return frame[6] & ~1u;
}
