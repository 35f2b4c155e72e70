//! Quotients of 64 bits, in place of those of `compiler_builtins`: these stand on the 128-bit arithmetic that the
//! controller has anyway.

use core::arch::global_asm;
use stage_controller::units::wide;

/// Quotient and remainder.
extern "C" fn divide(dividend: u64, divisor: u64, remainder: &mut u64) -> u64 {
    let quotient = match u32::try_from(divisor) {
        Ok(divisor) => wide::over_word(dividend, divisor),
        Err(_) => wide::div(dividend.into(), divisor.into()) as u64,
    };
    *remainder = dividend.wrapping_sub(quotient.wrapping_mul(divisor));
    quotient
}

/// Quotient, rounded towards zero, and remainder, which has the sign of the dividend.
extern "C" fn divide_signed(dividend: i64, divisor: i64, remainder: &mut u64) -> u64 {
    let quotient = divide(dividend.unsigned_abs(), divisor.unsigned_abs(), remainder);
    if dividend < 0 {
        *remainder = remainder.wrapping_neg();
    }
    if (dividend ^ divisor) < 0 { quotient.wrapping_neg() } else { quotient }
}

// As the run-time ABI for the Arm architecture wants them (IHI 0043, "The long long helper functions"): dividend in r0
// and r1, divisor in r2 and r3; then the quotient in r0 and r1, the remainder in r2 and r3.
global_asm!(
    ".syntax unified",
    ".macro quotient name, of",
    ".section .text.\\name, \"ax\", %progbits",
    ".global \\name",
    ".type \\name, %function",
    ".thumb_func",
    "\\name:",
    "push {{r0, r1, r2, r3, r4, lr}}", // room for the third argument and the remainder; the stack stays on 8 bytes
    "add r4, sp, #8",
    "str r4, [sp]",
    "bl \\of",
    "ldrd r2, r3, [sp, #8]",
    "add sp, #16",
    "pop {{r4, pc}}",
    ".size \\name, . - \\name",
    ".endm",
    "quotient __aeabi_uldivmod, {divide}",
    "quotient __aeabi_ldivmod, {divide_signed}",
    ".purgem quotient",
    divide = sym divide,
    divide_signed = sym divide_signed,
);
