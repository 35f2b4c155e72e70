#!/usr/bin/env bash
# Makes `cargo build --target thumbv7em-none-eabihf` possible.
#
#   PATH=$(tests/thumb-target.sh)$PATH cargo build --target thumbv7em-none-eabihf ...
#
# The ordinary way is `rustup target add`. Where rustup cannot download, compiler and sources of one version come from
# the packages of Debian (rust-web), core and alloc are built for the target, and everything is put into one directory;
# nothing is installed and no toolchain is changed. Prints what is to stand before PATH: that directory's bin and a
# colon, or nothing. Can be run again at any time.
#
#   THUMB_DIRECTORY   where the toolchain is made (target/thumb-toolchain, 500 MB)
#   THUMB_PACKAGES=1  never asks rustup
set -euo pipefail

target=thumbv7em-none-eabihf
root=$(cd "$(dirname "$0")/.." && pwd)
made=${THUMB_DIRECTORY:-${CARGO_TARGET_DIR:-$root/target}/thumb-toolchain}
cd "$root" # whose rust-toolchain.toml counts

say() { echo "thumb-target: $*" >&2; }

fail() {
    say "$*"
    exit 1
}

# Whether a compiler has core for the target.
has_core() {
    compgen -G "$("$1" --print target-libdir --target "$target" 2>/dev/null)/libcore-*.rlib" >/dev/null
}

# ---- rustup ----

if [ -z "${THUMB_PACKAGES:-}" ]; then
    ! has_core rustc || exit 0
    if [ ! -x "$made/bin/rustc" ] && timeout 300 rustup target add "$target" >&2 && has_core rustc; then
        exit 0
    fi
fi
if [ -x "$made/bin/rustc" ] && has_core "$made/bin/rustc"; then
    echo "$made/bin:"
    exit 0
fi

# ---- the packages ----

command -v apt-get >/dev/null || fail "rustup target add $target does not work, and there is no apt-get"
host=$(rustc -vV | sed -n 's/^host: //p')
triplet=${host/-unknown/} # as Debian calls it
own=$(rustc --print sysroot)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
chmod 755 "$work"

candidate() {
    apt-cache policy "$1" | sed -n 's/^  Candidate: \([^(].*\)/\1/p'
}

# Fetches the packages, all of one version.
fetch() {
    local version branch llvm
    version=$(candidate rust-web-src)
    [ -n "$version" ] || return 1
    branch=${version%%+*} # 1.96.0
    branch=${branch%.*}
    llvm=$(apt-cache show "libstd-rust-web-$branch=$version" | sed -n 's/^Depends:.*\(libllvm[0-9]*\).*/\1/p' | head -n 1)
    say "compiler and sources are $version of this distribution"
    (cd "$work" && apt-get -qq -o APT::Sandbox::User=root download "rust-web-src=$version" "rustc-web=$version" \
        "libstd-rust-web-dev=$version" "libstd-rust-web-$branch=$version" "rust-web-clippy=$version" "$llvm" >&2)
}

as_root=()
[ "$(id -u)" = 0 ] || as_root=(sudo -n)
fetch || { "${as_root[@]}" apt-get -qq update >&2 && fetch; } || fail "the packages of rust-web cannot be fetched"
for package in "$work"/*.deb; do
    case $package in
        */rust-web-src_*) dpkg --fsys-tarfile "$package" |
            tar -xC "$work" --wildcards --no-wildcards-match-slash \
                ./usr/src/rustc-*/library/{core,alloc,compiler-builtins,stdarch,portable-simd} ;;
        *) dpkg -x "$package" "$work/root" ;;
    esac
done

# ---- one directory with the compiler, and cargo and linker of the present toolchain ----

new=$made.new
rm -rf "$new" "$made"
mkdir -p "$new/bin" "$new/libexec"
mv "$work/root/usr/lib" "$new/lib"
# the compiler looks for its libraries beside librustc_driver; the system's loader has to be told where that is
for program in rustc rustdoc clippy-driver cargo-clippy; do
    mv "$work/root/usr/bin/$program" "$new/libexec/$program"
    cat >"$new/bin/$program" <<EOF
#!/bin/sh
here=\$(cd "\$(dirname "\$0")/.." && pwd)
export LD_LIBRARY_PATH="\$here/lib/$triplet\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}"
exec "\$here/libexec/$program" "\$@"
EOF
    chmod +x "$new/bin/$program"
done
ln -s "$own/bin/cargo" "$new/bin/cargo"
mkdir -p "$new/lib/rustlib/$host/bin"
for program in rust-lld rust-objcopy gcc-ld; do
    ln -s "$own/lib/rustlib/$host/bin/$program" "$new/lib/rustlib/$host/bin/$program"
done

# ---- core and alloc for the target ----

library=$(echo "$work"/usr/src/rustc-*/library)
# alloc, core and compiler_builtins alone: no dependency has to be fetched
(
    cd "$library"
    rm -f Cargo.lock {compiler-builtins,stdarch,portable-simd}/Cargo.{toml,lock}
    cat >Cargo.toml <<'EOF'
[workspace]
resolver = "1"
members = ["alloc"]
exclude = ["stdarch", "portable-simd", "compiler-builtins/libm", "compiler-builtins/crates"]
[profile.release]
codegen-units = 1
debug = 0
[profile.release.package.compiler_builtins]
codegen-units = 10000
EOF
    sed -i -e '/^cc = /d' -e 's/^c = .*/c = []/' compiler-builtins/compiler-builtins/Cargo.toml
    say "building core and alloc for $target"
    # as the distribution builds its own: unstable features, and the metadata by which rustc knows the standard library
    env -u RUSTUP_TOOLCHAIN -u CARGO_BUILD_TARGET RUSTC="$new/bin/rustc" RUSTC_BOOTSTRAP=1 \
        __CARGO_DEFAULT_LIB_METADATA=stablestd \
        CARGO_ENCODED_RUSTFLAGS=$'-Zforce-unstable-if-unmarked\x1f-Cembed-bitcode=yes' \
        "$new/bin/cargo" build -q --offline --release -p alloc --features compiler-builtins-mem \
        --target "$target" --target-dir "$work/build" >&2
)
mkdir -p "$new/lib/rustlib/$target/lib"
cp "$work/build/$target"/release/deps/lib{core,alloc,compiler_builtins}-*.rlib "$new/lib/rustlib/$target/lib/"
mv "$new" "$made"
has_core "$made/bin/rustc" || fail "$made/bin/rustc finds no core for $target"
echo "$made/bin:"
