//! The golden suite on a Cortex-M4F.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {
    println!("runs under QEMU: tests/run.sh qemu");
}

#[cfg(target_os = "none")]
mod target {
    use cortex_m_rt::entry;
    use embassy_stm32 as _; // the interrupt vectors

    #[entry]
    fn main() -> ! {
        loop {}
    }

    #[panic_handler]
    fn panic(_: &core::panic::PanicInfo) -> ! {
        loop {}
    }
}
