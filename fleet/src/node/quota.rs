//! How much others may have kept here.

use crate::manifest::{Entry, Kind};
use std::time::Duration;

/// How often a neighbour may say who it is and what it has, a second: some hundred times what one says. For a while it
/// may be five times as often.
const RATE: f64 = 200.0;
const BURST: f64 = 5.0 * RATE;

/// What another one's maps may take together: a peer's, where peers have keys, else a neighbour's.
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

/// Objects that a quota allows for each keyframe, and beside these: one has six of its own, and shares poses, edges and
/// frames with others.
const OF_KEYFRAME: usize = 16;
const BASE: usize = 1024;

/// What objects take.
#[derive(Clone, Copy, Default)]
pub(super) struct Load {
    bytes: u64,
    pub keyframes: usize,
    objects: usize,
}

impl Load {
    /// Of these objects.
    pub fn of(entries: &[Entry]) -> Self {
        let keyframes = entries.iter().filter(|entry| entry.kind == Kind::Depth).count();
        let bytes = entries.iter().map(|entry| u64::from(entry.size)).sum();
        Self { bytes, keyframes, objects: entries.len() }
    }

    /// All of some.
    pub fn sum(loads: impl Iterator<Item = Self>) -> Self {
        loads.fold(Self::default(), |sum, load| Self {
            bytes: sum.bytes + load.bytes,
            keyframes: sum.keyframes + load.keyframes,
            objects: sum.objects + load.objects,
        })
    }
}

impl Quota {
    /// Objects.
    pub(super) fn objects(&self) -> usize {
        BASE + OF_KEYFRAME * self.keyframes
    }

    /// Whether what one tells is not too much.
    pub(super) fn check(&self, Load { bytes, keyframes, objects }: Load) -> Result<(), String> {
        if objects > self.objects() {
            let most = self.objects();
            return Err(format!("what it tells has {objects} objects, more than the {most} that one may"));
        }
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
pub(super) struct TokenBucket {
    level: f64,
    at: Duration,
}

impl TokenBucket {
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
