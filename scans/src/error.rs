//! What reading scans refuses.

use thiserror::Error;

/// Why a scan or a folder of scans was not read.
#[derive(Debug, Error)]
pub enum ScanError {
    /// A file could not be read.
    #[error("{name}: cannot be read: {source}")]
    Io {
        /// The file.
        name: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file is not what its name says.
    #[error("{name}: {what}")]
    Format {
        /// The file.
        name: String,
        /// What is wrong with it and how to mend it.
        what: String,
    },
    /// Its time stamp is none of the recording's clock.
    #[error("{name}: {what}")]
    Mistimed {
        /// The scan.
        name: String,
        /// What is wrong with its stamp.
        what: String,
    },
    /// Too few points are left.
    #[error("{name}: {usable} of {read} points are usable, too few for a pose")]
    TooFew {
        /// The file.
        name: String,
        /// Points in the file.
        read: usize,
        /// Points that are finite and off the sensor.
        usable: usize,
    },
    /// A single ring.
    #[error(
        "{name}: all points lie in one plane through the sensor; a scan of one ring gives no pose in space"
    )]
    Flat {
        /// The file.
        name: String,
    },
}

impl ScanError {
    /// A [`Self::Format`].
    pub(crate) fn format(name: &str, what: impl Into<String>) -> Self {
        Self::Format { name: name.into(), what: what.into() }
    }
}
