//! The time-optimal profile in floating point and continuous time: what the tests compare with.

/// Velocity, acceleration and jerk limit per segment.
#[derive(Clone, Copy, Debug)]
pub struct Ideal {
    pub v: f64,
    pub a: f64,
    pub j: f64,
}

impl Ideal {
    pub fn forced(&self, a: f64) -> f64 {
        a * a.abs() / (2.0 * self.j)
    }

    /// Duration and way of the fastest transition to velocity `v1`.
    pub fn ramp(&self, v0: f64, a0: f64, v1: f64) -> (f64, f64) {
        let sign = if v1 >= v0 + self.forced(a0) { 1.0 } else { -1.0 };
        let (a, dv, j) = (sign * a0, sign * (v1 - v0), self.j);
        let peak = (j * dv + a * a / 2.0).max(0.0).sqrt().min(self.a);
        let (t1, t3) = ((peak - a).abs() / j, peak / j);
        let rest = dv - t1 * (a + peak) / 2.0 - t3 * peak / 2.0;
        let t2 = if peak < self.a { 0.0 } else { (rest / peak).max(0.0) };
        let way1 = v0 * t1 + sign * t1 * t1 * (2.0 * a + peak) / 6.0;
        let v = v0 + sign * t1 * (a + peak) / 2.0;
        let way2 = v * t2 + sign * t2 * t2 * peak / 2.0;
        let way3 = v1 * t3 - sign * t3 * t3 * peak / 6.0;
        (t1 + t2 + t3, way1 + way2 + way3)
    }

    fn through(&self, v0: f64, a0: f64, vc: f64) -> (f64, f64) {
        let (up, down) = (self.ramp(v0, a0, vc), self.ramp(vc, 0.0, 0.0));
        (up.0 + down.0, up.1 + down.1)
    }

    /// Duration of the fastest move over `way` to rest.
    pub fn time(&self, v0: f64, a0: f64, way: f64) -> f64 {
        let (stop_time, stop) = self.ramp(v0, a0, 0.0);
        if (way - stop).abs() < 1e-15 {
            return stop_time;
        }
        if way < stop {
            return self.time(-v0, -a0, -way);
        }
        let mut most = self.v;
        let free = v0 + self.forced(a0);
        let (mut low, mut high);
        if a0 < 0.0 && free > 0.0 && self.through(v0, a0, free.min(most)).1 > way {
            (low, high) = (0.0, -a0 / self.j);
            let eased = |t: f64| {
                let (a, v) = (a0 + self.j * t, v0 + a0 * t + self.j * t * t / 2.0);
                let s = v0 * t + a0 * t * t / 2.0 + self.j * t * t * t / 6.0;
                let stop = self.ramp(v, a, 0.0);
                (t + stop.0, s + stop.1)
            };
            for _ in 0..100 {
                let middle = (low + high) / 2.0;
                if eased(middle).1 > way { high = middle } else { low = middle }
            }
            return eased(low).0;
        }
        if free > most && a0 >= 0.0 && self.through(v0, a0, most).1 > way {
            most = free;
        }
        let full = self.through(v0, a0, most);
        if full.1 <= way {
            return full.0 + (way - full.1) / most;
        }
        (low, high) = (free.max(0.0), most);
        for _ in 0..100 {
            let middle = (low + high) / 2.0;
            if self.through(v0, a0, middle).1 > way { high = middle } else { low = middle }
        }
        let found = self.through(v0, a0, low);
        found.0 + if low > 0.0 { (way - found.1).max(0.0) / low } else { 0.0 }
    }
}
