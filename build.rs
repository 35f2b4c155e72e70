//! Hands the memory map of the board to the linker; other targets need none.
fn main() {
    println!("cargo:rerun-if-changed=memory.x");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let root = std::env::var("CARGO_MANIFEST_DIR").expect("set by cargo");
        println!("cargo:rustc-link-search={root}");
        for script in ["link.x", "defmt.x"] {
            println!("cargo:rustc-link-arg-bins=-T{script}");
        }
    }
}
