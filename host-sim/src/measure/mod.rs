//! Measurements of a stage as instruments would give them, from its exact model.
