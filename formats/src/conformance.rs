//! What every reader must do, as a check that any reader can be put through.
