//! What the mergings of cameras' and of LiDARs' maps share: how often a common map is written, and what goes wrong with one.

use std::time::Duration;

/// How often a common map is written while maps still grow.
pub(super) const WRITE_INTERVAL: Duration = Duration::from_secs(30);

/// What went wrong.
pub(super) enum Failed {
    /// Maps cannot be merged.
    Merge(anyhow::Error),
    /// Results cannot be written.
    Write(anyhow::Error),
}
