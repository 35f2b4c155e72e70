//! Hands the memory map of the emulated chip to the linker; other targets need none.
fn main() {
    println!("cargo:rerun-if-changed=qemu.x");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let here = std::env::var("CARGO_MANIFEST_DIR").expect("set by cargo");
        // link.x includes the board's memory.x, which lies where the linker runs; the last script has the last word
        println!("cargo:rustc-link-arg-bins=-Tlink.x");
        println!("cargo:rustc-link-arg-bins=-T{here}/qemu.x");
    }
}
