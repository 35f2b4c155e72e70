//! The language: bytes of a link -> messages -> calls, answers -> bytes. Nothing here knows what moves.
//!
//! One [`session::Session`] per link ties the parts: [`lexer`] frames, [`parser`] splits a message into calls of the
//! one table in [`tree`], [`status`] keeps the link's registers and error queue, [`response`] its answers. What a bus adds to that (who may talk
//! when, service requests, device clear) is in `exchange`.

mod common;
#[cfg(feature = "bus")]
pub mod exchange;
pub mod lexer;
pub mod params;
pub mod parser;
pub mod response;
pub mod session;
pub mod status;
pub mod tree;
