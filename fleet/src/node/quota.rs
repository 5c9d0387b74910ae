//! How much others may have kept here.

use crate::manifest::{Entry, Kind};
use std::time::Duration;

/// How often a neighbour may say who it is and what it has, a second: some hundred times what one says. For a while it
/// may be five times as often.
const RATE: f64 = 200.0;
const BURST: f64 = 5.0 * RATE;

/// What another one's maps may take together: a party's, where parties have keys, else a neighbour's.
#[derive(Clone, Copy, Debug)]
pub struct Quota {
    /// Bytes of all objects.
    pub bytes: u64,
    /// Keyframes.
    pub keyframes: usize,
    /// Maps.
    pub maps: usize,
}

impl Default for Quota {
    /// 16 GiB, 30,000 keyframes, some hours of driving, and 256 maps.
    fn default() -> Self {
        Self { bytes: 16 << 30, keyframes: 30_000, maps: 256 }
    }
}

/// What objects take.
pub(super) struct Load {
    bytes: u64,
    keyframes: usize,
}

impl Load {
    /// Of these objects.
    pub fn of<'a>(entries: impl Iterator<Item = &'a Entry>) -> Self {
        entries.fold(Self { bytes: 0, keyframes: 0 }, |sum, entry| Self {
            bytes: sum.bytes + u64::from(entry.size),
            keyframes: sum.keyframes + usize::from(entry.kind == Kind::Depth),
        })
    }
}

impl Quota {
    /// Whether what one tells is not too much.
    pub(super) fn check(&self, Load { bytes, keyframes }: Load) -> Result<(), String> {
        if bytes > self.bytes {
            return Err(format!(
                "what it tells takes {bytes} bytes, more than the {} that one may",
                self.bytes
            ));
        }
        if keyframes > self.keyframes {
            return Err(format!(
                "what it tells has {keyframes} keyframes, more than the {} it may",
                self.keyframes
            ));
        }
        Ok(())
    }
}

/// What a neighbour said lately, as a bucket that runs out.
#[derive(Default)]
pub(super) struct Said {
    level: f64,
    at: Duration,
}

impl Said {
    /// It says something.
    ///
    /// # Errors
    /// When that is too much.
    pub fn one_more(&mut self, now: Duration) -> Result<(), String> {
        let passed = now.saturating_sub(self.at).as_secs_f64();
        self.level = (self.level - passed * RATE).max(0.0) + 1.0;
        self.at = now;
        if self.level > BURST {
            return Err(format!("it says more than {RATE} times a second who it is and what it has"));
        }
        Ok(())
    }
}
