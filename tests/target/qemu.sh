#!/bin/sh
# Runs a program for the Cortex-M4F under QEMU; what it prints and its status come back by semihosting.
#
#   tests/target/qemu.sh ELF
#
# With -icount time passes by instructions, so that a run is the same each time. A fault leaves the program in an
# endless loop: QEMU_SECONDS (300) end that.
set -u
seconds=${QEMU_SECONDS:-300}
timeout "$seconds" qemu-system-arm -M netduinoplus2 -nographic -monitor none -serial null \
    -semihosting-config enable=on,target=native -icount shift=3,align=off,sleep=off -kernel "$@" </dev/null
status=$?
[ $status -ne 124 ] || echo "the program did not end within $seconds s: a fault, or set QEMU_SECONDS" >&2
exit $status
