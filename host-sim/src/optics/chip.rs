//! The splitter chip and the fibre array behind it.

/// Sizes of which a splitter is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplitterSize {
    /// Outputs.
    pub channels: usize,
    /// Distance of neighbouring guides, um.
    pub pitch_um: f64,
    /// Mean loss beyond the split, dB.
    pub excess_db: f64,
    /// Standard deviation of that from output to output, dB.
    pub excess_sigma_db: f64,
}

impl Default for SplitterSize {
    /// 1 to 8 on 250 um, 0.6 dB with 0.05 dB.
    fn default() -> Self {
        SplitterSize { channels: 8, pitch_um: 250.0, excess_db: 0.6, excess_sigma_db: 0.05 }
    }
}

/// A 1 x N splitter: what is lost from its input guide to each of its outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Splitter {
    /// Distance of neighbouring output guides, um. Channel i is i pitches to -x of channel 0; lithography makes no
    /// error.
    pub pitch_um: f64,
    /// From the input guide to each output guide, dB: the split and the excess.
    pub loss_db: Vec<f64>,
}

impl Splitter {
    /// Draws a splitter; `normal` gives normal numbers of standard deviation 1.
    pub fn draw(size: &SplitterSize, mut normal: impl FnMut() -> f64) -> Self {
        let split = 10.0 * (size.channels as f64).log10();
        let loss = |_| split + size.excess_db + size.excess_sigma_db * normal();
        Splitter { pitch_um: size.pitch_um, loss_db: (0..size.channels).map(loss).collect() }
    }

    /// Share of the power in the input guide that leaves all outputs together.
    pub fn total(&self) -> f64 {
        self.loss_db.iter().map(|loss| super::milliwatts(-loss)).sum()
    }
}

/// Sizes of which a fibre array is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArraySize {
    /// Fibres.
    pub channels: usize,
    /// Distance of neighbouring cores, um.
    pub pitch_um: f64,
    /// Standard deviation of a core's place in x and in y, um.
    pub core_sigma_um: f64,
}

/// A rigid fibre array: where its cores are.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Cores from the fibre point, where channel 0 is meant to be, in the plane of the face, um.
    pub cores_um: Vec<[f64; 2]>,
}

impl Array {
    /// Draws an array; `normal` gives normal numbers of standard deviation 1. A single fibre is where the fibre point is.
    pub fn draw(size: &ArraySize, mut normal: impl FnMut() -> f64) -> Self {
        let core = |i: usize| {
            let at = -size.pitch_um * i as f64;
            [at + size.core_sigma_um * normal(), size.core_sigma_um * normal()]
        };
        Array { cores_um: (0..size.channels).map(core).collect() }
    }

    /// One fibre, at the fibre point.
    pub fn single() -> Self {
        Array { cores_um: vec![[0.0; 2]] }
    }
}
