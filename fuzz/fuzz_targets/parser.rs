//! Any bytes in any chunks on a link: nothing panics, and the next command works.
#![no_main]

use host_sim::board::{Board, Interleaving};
use host_sim::machine::Machine;
use host_sim::session::block_of;
use libfuzzer_sys::fuzz_target;
use stage_controller::controller::front::Front;
use stage_controller::controller::links::Links;
use std::sync::OnceLock;

/// Longer than a pause in a block may be, ms.
const PAUSE_MS: u64 = 3000;
/// Segments that pass at most between two chunks.
const CHUNK_SEGMENTS: u8 = 16;

fn board() -> Board {
    static BLOCK: OnceLock<Vec<u8>> = OnceLock::new();
    let mut front = Front::new();
    front.load(BLOCK.get_or_init(|| block_of(&Machine::paper()).unwrap())).unwrap();
    front.assume_homed();
    let mut board = Board::new(&Machine::paper(), front, Interleaving::Prompt, 1);
    board.settle();
    board
}

fn drain(links: &mut Links<1>) -> Vec<u8> {
    let (mut answer, mut chunk) = (Vec::new(), [0; 256]);
    loop {
        match links.transmit(0, &mut chunk) {
            0 => return answer,
            n => answer.extend_from_slice(&chunk[..n]),
        }
    }
}

/// Polls and lets time pass until the link takes no more and has nothing more to say.
fn quiet(board: &mut Board, links: &mut Links<1>, now_ms: u64) {
    for _ in 0..256 {
        let progress = links.poll(&mut board.front, now_ms);
        let answered = !drain(links).is_empty();
        board.front.abort();
        for _ in 0..16 {
            board.step(|_| ());
        }
        if !progress && !answered && !board.front.operation_pending() {
            return;
        }
    }
    panic!("the link never falls quiet");
}

fuzz_target!(|data: &[u8]| {
    // the first byte of a chunk: how long it is, and how long the pause behind it
    let (mut board, mut links) = (board(), Links::<1>::new());
    links.open(0);
    let mut rest = data;
    let mut offered: Vec<u8> = Vec::new();
    while let Some((control, tail)) = rest.split_first() {
        let length = usize::from(control >> 2).clamp(1, tail.len().max(1)).min(tail.len());
        let (chunk, tail) = tail.split_at(length);
        rest = tail;
        offered.extend_from_slice(chunk);
        let taken = links.receive(0, &offered, 0);
        offered.drain(..taken);
        links.poll(&mut board.front, 0);
        if control & 1 != 0 {
            drain(&mut links);
        }
        for _ in 0..(control & 2) / 2 * CHUNK_SEGMENTS {
            board.step(|_| ());
        }
    }
    for _ in 0..64 {
        quiet(&mut board, &mut links, PAUSE_MS);
        if offered.is_empty() {
            break;
        }
        let taken = links.receive(0, &offered, 0);
        offered.drain(..taken);
    }
    assert!(offered.is_empty(), "bytes are never taken");
    // a block that has not ended is given up after a pause; a line that has not ended, by its LF
    quiet(&mut board, &mut links, PAUSE_MS);
    assert_eq!(links.receive(0, b"\n", PAUSE_MS), 1);
    quiet(&mut board, &mut links, 2 * PAUSE_MS);
    let question = b"*CLS;*IDN?;SYST:ERR?\n";
    assert_eq!(links.receive(0, question, 2 * PAUSE_MS), question.len());
    links.poll(&mut board.front, 2 * PAUSE_MS);
    let answer = String::from_utf8_lossy(&drain(&mut links)).into_owned();
    assert!(answer.starts_with("Stage Controller,") && answer.ends_with("0,\"No error\"\n"), "{answer}");
});
