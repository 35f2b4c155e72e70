//! The arithmetic of planning: integers only, and no operation that panics.
//!
//! - [`wide`]: exact products, quotients and roots of 128-bit integers on a 32-bit processor.
//! - [`rough`]: numbers of 32 significant bits for bounds, each operation rounded to a named side.
//!
//! A crate of its own, because it is compiled for speed and the planning that stands on it for size.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
mod random;
pub mod rough;
pub mod wide;
