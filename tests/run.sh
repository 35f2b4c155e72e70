#!/usr/bin/env bash
# All tests, on a fresh Debian or Ubuntu with Rust.
#
#   tests/run.sh                 every stage
#   tests/run.sh clients fuzz    some of them
#
# FUZZ_SECONDS: time for each fuzz target (60).
set -euo pipefail
cd "$(dirname "$0")/.."

STAGES="fmt clippy doc no_std unit property golden words qemu wiring firmware cost emulator manual tree scripts readme clients fuzz bench"
FUZZ_SECONDS=${FUZZ_SECONDS:-60}
TARGET=${CARGO_TARGET_DIR:-$PWD/target}
LOGS=$TARGET/test-logs
VENV=$PWD/.venv
SKIPPED=77

# ---- what the stages need ----

# Ends a stage with its reason.
skip() {
    echo "SKIPPED: $*"
    exit $SKIPPED
}

# Installs a Debian package if we may.
apt_install() {
    local as_root=()
    [ "$(id -u)" = 0 ] || as_root=(sudo -n)
    "${as_root[@]}" true 2>/dev/null || return 1
    "${as_root[@]}" apt-get install -y -q "$@" ||
        { "${as_root[@]}" apt-get update -q && "${as_root[@]}" apt-get install -y -q "$@"; }
}

# A virtual environment with the packages that a file names.
need_venv() {
    command -v python3 >/dev/null || apt_install python3 || skip "install python3: apt-get install python3 python3-venv"
    if [ ! -x "$VENV/bin/pip" ]; then
        rm -rf "$VENV"
        python3 -m venv "$VENV" || {
            rm -rf "$VENV"
            apt_install python3-venv && python3 -m venv "$VENV"
        } || skip "install python3-venv: apt-get install python3-venv"
    fi
    "$VENV/bin/pip" install -q --disable-pip-version-check -r "$1" || skip "pip cannot install what $1 names"
}

# A compiler for the board's processor, first in PATH.
need_thumb() {
    local before
    before=$(tests/thumb-target.sh) || skip "no bare-metal target: rustup target add thumbv7em-none-eabihf"
    export PATH=$before$PATH
}

# An emulator of a Cortex-M4F.
need_qemu() {
    command -v qemu-system-arm >/dev/null || apt_install qemu-system-arm ||
        skip "install QEMU: apt-get install qemu-system-arm"
    qemu-system-arm -M help | grep -q '^netduinoplus2 ' || skip "this QEMU has no netduinoplus2: version 6 or later has"
}

host_sim() {
    cargo build -q --release -p host-sim
    export HOST_SIM=$TARGET/release/host-sim
}

firmware() {
    need_thumb
    cargo fw -q
    export FIRMWARE_ELF=$TARGET/thumbv7em-none-eabihf/firmware/stage-controller
}

# ---- the stages ----

stage_fmt() { # Formatting
    cargo fmt --version || skip "install rustfmt: rustup component add rustfmt"
    cargo fmt --all --check
    cargo fmt --manifest-path fuzz/Cargo.toml --check
}

stage_clippy() { # Clippy without warnings
    cargo clippy --version || skip "install clippy: rustup component add clippy"
    cargo clippy -q --workspace --all-targets -- -D warnings
    need_thumb
    cargo clippy -q -p target-tests --target thumbv7em-none-eabihf -- -D warnings
    cargo clippy -q --profile firmware -p stage-controller --bin stage-controller --target thumbv7em-none-eabihf -- -D warnings
}

stage_doc() { # Documentation without warnings
    RUSTDOCFLAGS="-D warnings" cargo doc -q --no-deps --workspace
}

stage_no_std() { # The library builds with no operating system
    need_thumb
    cargo build -q --release -p stage-controller --lib --target thumbv7em-none-eabihf
    cargo build -q --release -p stage-gpib --target thumbv7em-none-eabihf
    cargo build -q --release -p stage-usb488 --target thumbv7em-none-eabihf
}

stage_unit() { # All tests, debug build
    cargo test --no-fail-fast
}

stage_property() { # All tests, release build: properties at full volume
    cargo test --release --no-fail-fast -- --show-output
}

stage_golden() { # Golden vectors computed anew by an independent program
    command -v python3 >/dev/null || skip "install python3"
    python3 -c 'import tomllib' || skip "the golden vectors need Python 3.11 or later"
    local files
    # those of machines; the others are vectors of the arithmetic alone
    mapfile -t files < <(grep -l '"machine": {' tests/golden/*.json)
    python3 tests/golden/make_golden.py --check "${files[@]}"
}

stage_words() { # Debug and release builds play the same words
    host_sim
    cargo run -q -p host-sim -- trace -o "$LOGS/debug.vcd"
    "$HOST_SIM" trace -o "$LOGS/release.vcd"
    cmp "$LOGS/debug.vcd" "$LOGS/release.vcd"
}

stage_qemu() { # The same words on a Cortex-M4F under QEMU
    need_thumb
    need_qemu
    cargo qemu -q
}

stage_wiring() { # The pins are the same in code, tables and picture
    command -v python3 >/dev/null || skip "install python3"
    tests/wiring.py
}

stage_firmware() { # The firmware links, fits, and its refill cannot panic
    firmware
    need_venv tests/emulator/requirements.txt
    "$VENV/bin/python" tests/emulator/size.py "$FIRMWARE_ELF"
    "$VENV/bin/python" tests/emulator/panic_paths.py "$FIRMWARE_ELF"
    python3 tools/image.py "$FIRMWARE_ELF" "$LOGS"
}

stage_cost() { # What refill and planning cost on the chip, against the figures kept
    firmware
    host_sim
    need_venv tests/emulator/requirements.txt
    "$VENV/bin/python" tests/emulator/isr_cost.py "$FIRMWARE_ELF" --check
    cargo build -q --profile firmware -p target-tests --bin plan_cost --target thumbv7em-none-eabihf
    # a move begins within a millisecond of its command: planning may take the smaller half of that
    "$VENV/bin/python" tests/emulator/plan_cost.py --host-sim "$HOST_SIM" --most 75000 \
        "$TARGET/thumbv7em-none-eabihf/firmware/plan_cost"
}

stage_emulator() { # The firmware that is flashed, in an emulator of the board
    firmware
    host_sim
    need_venv tests/emulator/requirements.txt
    "$VENV/bin/pytest" -q -rP -p no:cacheprovider -n auto tests/emulator
}

stage_manual() { # docs/COMMANDS.md is what the command tree gives
    host_sim
    "$HOST_SIM" manual --check docs/COMMANDS.md
}

stage_tree() { # The command tree is JSON
    command -v python3 >/dev/null || skip "install python3"
    cargo run -q -p stage-controller >"$LOGS/tree.json"
    python3 -m json.tool "$LOGS/tree.json" >/dev/null
}

stage_scripts() { # Scripts pass shellcheck
    command -v shellcheck >/dev/null || apt_install shellcheck || skip "install shellcheck: apt-get install shellcheck"
    shellcheck tests/run.sh tests/thumb-target.sh tests/target/qemu.sh .ci/run
}

stage_readme() { # What the README tells to type works
    need_thumb
    need_venv tests/clients/requirements.txt
    host_sim
    "$VENV/bin/python" tests/readme.py README.md
}

stage_clients() { # PyVISA over a socket and over a serial port
    need_venv tests/clients/requirements.txt
    host_sim
    "$VENV/bin/pytest" -q -p no:cacheprovider tests/clients
}

stage_fuzz() { # Any bytes, any calibration block
    command -v python3 >/dev/null || skip "install python3"
    cargo +nightly --version || skip "no nightly Rust: rustup toolchain install nightly"
    cargo fuzz --version || cargo install cargo-fuzz --locked || skip "cargo-fuzz cannot be installed"
    host_sim
    local blocks=() machine target
    for machine in host-sim/machines/*.toml; do
        blocks+=("$LOGS/$(basename "$machine" .toml).cal")
        "$HOST_SIM" calibrate "$machine" -o "${blocks[-1]}"
    done
    cargo run -q -p stage-controller >"$LOGS/tree.json"
    python3 fuzz/seeds.py "$LOGS/tree.json" fuzz/corpus "${blocks[@]}"
    export CARGO_TARGET_DIR=$TARGET/fuzz
    for target in parser calibration_block; do
        cargo +nightly fuzz run "$target" -- "-max_total_time=$FUZZ_SECONDS" -max_len=2048 -len_control=0 -verbosity=0
    done
}

stage_bench() { # Speed of the simulation
    host_sim
    "$HOST_SIM" bench
}

# ---- running them ----

passed=0 failed=0 skipped=0

# How many tests a log tells of: passed, failed, skipped. Nothing for a stage that is one test.
count() {
    awk '
        /^test result: /                      { p += $4; f += $6; s += $8; any = 1; next }
        /^golden: [0-9]+ passed, [0-9]+ failed$/ { p += $2; f += $4; any = 1; next }
        / (passed|failed|skipped|error).* in [0-9.]+s/ {
            for (i = 2; i <= NF; i++) {
                if ($i ~ /^passed/) p += $(i - 1)
                if ($i ~ /^(failed|error)/) f += $(i - 1)
                if ($i ~ /^skipped/) s += $(i - 1)
            }
            any = 1
        }
        END { if (any) print p + 0, f + 0, s + 0 }' "$1"
}

# What a log says of a failure: each panic of a Rust test with its reason, or else its end.
complaints() {
    grep -A 4 ' panicked at ' "$1" | grep -v 'stack backtrace' || tail -n 60 "$1"
}

run() {
    local name=$1 log=$LOGS/$1.log start=$SECONDS status=0 result=ok counts p f s title
    title=$(sed -n "s/^stage_$name() { # //p" "$0")
    printf '%-9s %-58s ' "$name" "$title"
    # in the background, so that a failing command ends the stage (set -e does nothing below ||)
    ( set -e; "stage_$name" ) >"$log" 2>&1 </dev/null &
    wait $! || status=$?
    counts=$(count "$log")
    read -r p f s <<<"${counts:-0 0 0}"
    case $status in
        0) [ -n "$counts" ] || p=1 ;;
        "$SKIPPED") p=0 f=0 s=1 result=SKIPPED ;;
        *) result=FAILED
           [ "$f" -gt 0 ] || f=1 ;;
    esac
    passed=$((passed + p)) failed=$((failed + f)) skipped=$((skipped + s))
    printf '%-8s %4d s\n' "$result" $((SECONDS - start))
    case $result in
        SKIPPED) sed -n 's/^SKIPPED: /          /p' "$log" ;;
        FAILED) complaints "$log" | sed 's/^/    /'
                echo "    all of it: $log" ;;
        *) sed -n 's/^test \(.*\) \.\.\. ignored,* *\(.*\)/          skipped: \1 (\2)/p' "$log"
           [ "$name" != bench ] || sed 's/^/    /' "$log"
           case $name in
               property | qemu | firmware | cost | emulator) sed -n 's/^figure: /    /p; s/^target missed: /    target missed: /p' "$log" ;;
           esac ;;
    esac
}

main() {
    command -v cargo >/dev/null || { echo "install Rust first: https://rustup.rs"; exit 1; }
    mkdir -p "$LOGS"
    local name
    for name in "$@"; do
        case " $STAGES " in
            *" $name "*) ;;
            *) echo "no stage \"$name\"; there are: $STAGES"; exit 2 ;;
        esac
    done
    # shellcheck disable=SC2086 # a list of words
    [ $# -gt 0 ] || set -- $STAGES
    for name in "$@"; do
        run "$name"
    done
    echo "$passed passed, $failed failed, $skipped skipped"
    [ "$failed" -eq 0 ]
}

main "$@"
