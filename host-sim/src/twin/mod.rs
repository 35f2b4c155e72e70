//! The physical twin: what the step words do to a real stage.
