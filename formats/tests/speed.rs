//! Figures, not checks: run with `--release -- --ignored --nocapture speed`.
