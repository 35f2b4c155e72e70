//! Two boards and a power meter on a bus, without sockets.

use host_sim::bench_twin::{Bench, Options};
use host_sim::board::{Board, Interleaving};
use host_sim::gpib::{Bus, Claims, Instrument, Wired};
use host_sim::machine::Machine;
use host_sim::power_meter;
use host_sim::rig::Rig;
use host_sim::session::power_up;
use stage_controller::scpi::exchange::Exchange;
use stage_controller::scpi::session::Session;
use std::time::Duration;

/// Two boards at 5 and 6, a meter at 7.
pub struct Bench3 {
    pub boards: [Board; 2],
    pub links: [(Session, Exchange); 2],
    pub meter: (power_meter::Session, Exchange),
    rig: Rig,
    claims: Claims,
    /// So often a client has gone.
    pub released: usize,
}

impl Bench3 {
    pub fn new() -> Self {
        let board = |seed| {
            let machine = Machine::paper();
            let mut board = Board::new(&machine, power_up(&machine, false).unwrap(), Interleaving::Prompt, seed);
            board.settle();
            board
        };
        Bench3 {
            boards: [board(1), board(2)],
            links: [0, 1].map(|n| (Session::new(n), Exchange::new())),
            meter: (power_meter::Session::new(), Exchange::new()),
            rig: Rig::new(Bench::seeded(4, &Options::default())),
            claims: Claims::default(),
            released: 0,
        }
    }

    /// Virtual time.
    pub fn pass(&mut self, segments: usize) {
        for _ in 0..segments {
            self.boards.iter_mut().for_each(|board| board.step(|_| ()));
            self.rig.border(self.boards.each_mut());
            self.meter.0.see(&self.rig.bench, self.rig.tick());
            for address in self.addresses() {
                self.instrument(address, Duration::ZERO).unwrap().requests_service();
            }
        }
    }

    pub fn moves(&self) -> bool {
        self.boards.iter().any(|board| board.front.operation_pending()) || self.meter.0.wants_time()
    }
}

impl Bus for Bench3 {
    fn addresses(&self) -> Vec<u8> {
        vec![5, 6, 7]
    }

    fn instrument(&mut self, address: u8, _: Duration) -> Option<Box<dyn Instrument + '_>> {
        let Bench3 { boards, links, meter, rig, .. } = self;
        match address {
            5 | 6 => {
                let n = usize::from(address - 5);
                let (device, exchange) = &mut links[n];
                let front = &mut boards[n].front;
                let poll = move |session: &mut Session, see: &mut dyn FnMut(u8)| session.poll_message(front, see);
                Some(Box::new(Wired { exchange, device, poll }))
            }
            7 => {
                let (device, exchange) = meter;
                let poll = move |session: &mut power_meter::Session, see: &mut dyn FnMut(u8)| {
                    let tick = rig.tick();
                    session.poll_message(&mut rig.bench, tick, see)
                };
                Some(Box::new(Wired { exchange, device, poll }))
            }
            _ => None,
        }
    }

    fn release(&mut self, address: u8) {
        self.released += 1;
        let n = usize::from(address - 5);
        if let Some(board) = self.boards.get_mut(n) {
            board.front.end_jogs(n as u8);
        }
    }

    fn claims(&mut self) -> &mut Claims {
        &mut self.claims
    }
}
