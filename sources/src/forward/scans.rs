//! Scans whose time goes forward.

use super::{Clock, Judged, LOOKED_AHEAD};
use scans::{NextScan, ScanError, ScanInfo, ScanSource};
use std::collections::VecDeque;

/// A LiDAR's recording whose time goes forward: a scan whose stamp is no time of its clock is none, and those after the clock was set
/// have the time as it would have gone on.
pub struct ForwardScans {
    inner: Box<dyn ScanSource>,
    clock: Clock,
    ahead: VecDeque<NextScan>,
    ended: bool,
}

impl ForwardScans {
    /// The recording from here on.
    pub fn new(inner: Box<dyn ScanSource>) -> Self {
        Self { inner, clock: Clock::default(), ahead: VecDeque::new(), ended: false }
    }

    fn hold(&mut self, count: usize) {
        while self.ahead.len() < count && !self.ended {
            match self.inner.next_scan() {
                Some(scan) => self.ahead.push_back(scan),
                None => self.ended = true,
            }
        }
    }
}

impl ScanSource for ForwardScans {
    fn info(&self) -> &ScanInfo {
        self.inner.info()
    }

    fn next_scan(&mut self) -> Option<NextScan> {
        self.hold(1);
        let mut next = self.ahead.pop_front()?;
        // What cannot be read has no time that counts.
        let Ok(scan) = &mut next.scan else {
            next.stamp = self.clock.last().unwrap_or(next.stamp);
            return Some(next);
        };
        let mut following = Vec::new();
        if !self.clock.is_plain(next.stamp) {
            self.hold(LOOKED_AHEAD);
            following.extend(self.ahead.iter().filter(|next| next.scan.is_ok()).map(|next| next.stamp));
        }
        let what = match self.clock.judge(next.stamp, &following) {
            Judged::At(time) => {
                (scan.stamp, next.stamp) = (time, time);
                return Some(next);
            }
            Judged::Repeats => "repeats that of the scan before",
            Judged::Off => "lies off those around it",
            Judged::NoTime => "is no number",
        };
        let name = format!("{}: scan {}", self.inner.info().path.display(), next.index);
        next.scan = Err(ScanError::Mistimed { name, what: format!("its time stamp {} {what}", next.stamp) });
        next.stamp = self.clock.last().unwrap_or(next.stamp);
        Some(next)
    }

    fn remarks(&self) -> Vec<String> {
        self.inner.remarks().into_iter().chain(self.clock.faults().texts()).collect()
    }
}
