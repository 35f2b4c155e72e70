//! The stage's geometry in f64: the exact static chain, the reference for every fixed-point result, and the model of
//! all its errors.

mod accuracy;
mod chain;
mod ensemble;
mod errors;
mod field;
mod figure;
mod paper;
mod propagation;
mod rotation;
mod sensitivity;
mod structure;
mod tables;
mod topology;
mod truth;

pub use accuracy::{Accuracy, AccuracyOptions, Fields, MotionAccuracy, accuracy, beyond_travel};
pub(crate) use chain::static_vector;
pub use chain::{Chain, Screw};
pub use ensemble::{Ensemble, EnsembleStatistics, Spread, ensemble};
pub use errors::{ErrorModel, Form, Frame, Positions, SixErrors};
pub use field::{
    Compensation, Field, Grid, Motion, Size, Statistics, compensated_field, error_field, percentile, statistics,
};
pub use figure::{FigureRow, accuracy_figure, figure};
pub use paper::{Claim, Verdict, paper_claims};
pub use propagation::{Deviation, FirstOrderGap};
pub use rotation::{Euler, exp, vee};
pub use sensitivity::{
    Background, KinematicRow, Magnitudes, Options, Rank, Sensitivity, StaticRow, UnitMotion, sensitivity,
};
pub use structure::{Structure, structure};
pub use tables::{
    CharacteristicRow, ErrorRow, StaticErrorRow, characteristic_matrices, kinematic_errors, static_errors,
};
pub use topology::{BASE, CHIP, Joint, PairFreedom, Topology, TopologyError, Turned, coordinate};
pub use truth::Truth;
