//! The samples of a line in bounded memory: when it is full, neighbours are joined.

/// Points that are kept.
pub const CAPACITY: usize = 256;

/// Position, nm or nrad from where the scan began, and level, millionths of a dBm.
pub type Point = (i32, i32);

/// Points of equal weight, however many samples there were: each is the mean of [`Samples::joined`] of them. A parabola
/// keeps its maximum under such means.
#[derive(Clone, Copy, Debug)]
pub struct Samples {
    points: [Point; CAPACITY],
    length: u16,
    /// Samples of a point, less one.
    more: u32,
    /// Samples of the unfinished point.
    pending: u32,
    sum: (i64, i64),
}

impl Default for Samples {
    fn default() -> Self {
        Samples::new()
    }
}

impl Samples {
    /// None. All bytes are zero.
    pub const fn new() -> Self {
        Samples { points: [(0, 0); CAPACITY], length: 0, more: 0, pending: 0, sum: (0, 0) }
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        (self.length, self.more, self.pending, self.sum) = (0, 0, 0, (0, 0));
    }

    /// The points.
    pub fn points(&self) -> &[Point] {
        self.points.get(..usize::from(self.length)).unwrap_or(&[])
    }

    /// The points, to be worked on.
    pub fn points_mut(&mut self) -> &mut [Point] {
        self.points.get_mut(..usize::from(self.length)).unwrap_or(&mut [])
    }

    /// Samples of a point.
    pub fn joined(&self) -> u32 {
        self.more + 1
    }

    /// Adds a sample.
    #[inline(never)]
    pub fn push(&mut self, (x, y): Point) {
        self.sum = (self.sum.0 + i64::from(x), self.sum.1 + i64::from(y));
        self.pending += 1;
        if self.pending <= self.more {
            return;
        }
        let mean = |sum: i64| sum.checked_div(self.pending.into()).unwrap_or(0) as i32;
        let point = (mean(self.sum.0), mean(self.sum.1));
        (self.pending, self.sum) = (0, (0, 0));
        if let Some(place) = self.points.get_mut(usize::from(self.length)) {
            *place = point;
            self.length += 1;
        }
        if usize::from(self.length) >= CAPACITY {
            self.join();
        }
    }

    fn join(&mut self) {
        for n in 0..CAPACITY / 2 {
            let ((ax, ay), (bx, by)) = (self.points[2 * n], self.points[2 * n + 1]);
            let mean = |a: i32, b: i32| (a >> 1) + (b >> 1) + (a & b & 1);
            self.points[n] = (mean(ax, bx), mean(ay, by));
        }
        self.length = CAPACITY as u16 / 2;
        self.more = 2 * self.more + 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_number_of_samples_keeps_its_mean_position_and_order() {
        for count in [1, 255, 256, 257, 1000, 100_000] {
            let mut samples = Samples::new();
            (0..count).for_each(|n| samples.push((10 * n, -n)));
            let points = samples.points();
            assert!(points.len() >= (count as usize).min(CAPACITY / 2) && points.len() < CAPACITY);
            assert!(points.windows(2).all(|pair| pair[0].0 < pair[1].0));
            assert!(points.iter().all(|(x, y)| (x + 10 * y).abs() <= 20));
            assert!(points.len() as u32 * samples.joined() <= count as u32);
        }
    }
}
