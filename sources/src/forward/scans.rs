//! Scans whose time goes forward.

use super::{Clock, LOOKED_AHEAD, StampVerdict};
use scans::{NextScan, ScanError, ScanInfo, ScanSource};
use std::collections::VecDeque;

/// A LiDAR's recording whose time grows. A scan whose stamp is not of the recording's clock becomes an error; scans
/// after the clock was set get the time of the continued clock.
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

    fn read_ahead(&mut self, count: usize) {
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
        self.read_ahead(1);
        let mut next = self.ahead.pop_front()?;
        // What cannot be read has no time that counts.
        let Ok(scan) = &mut next.scan else {
            next.stamp = self.clock.last().unwrap_or(next.stamp);
            return Some(next);
        };
        let mut following = Vec::new();
        if !self.clock.is_plain(next.stamp) {
            self.read_ahead(LOOKED_AHEAD);
            following.extend(self.ahead.iter().filter(|next| next.scan.is_ok()).map(|next| next.stamp));
        }
        let what = match self.clock.judge(next.stamp, &following) {
            StampVerdict::At(time) => {
                (scan.stamp, next.stamp) = (time, time);
                return Some(next);
            }
            StampVerdict::Repeats => "repeats that of the scan before",
            StampVerdict::Off => "lies off those around it",
            StampVerdict::NoTime => "is no number",
        };
        let name = format!("{}: scan {}", self.inner.info().path.display(), next.index);
        next.scan = Err(ScanError::Mistimed { name, what: format!("its time stamp {} {what}", next.stamp) });
        next.stamp = self.clock.last().unwrap_or(next.stamp);
        Some(next)
    }

    /// Scans that are left out say so themselves.
    fn remarks(&self) -> Vec<String> {
        self.inner.remarks().into_iter().chain(self.clock.faults().of_set()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::scans::Scan;

    /// Scans with these stamps; one that is no number cannot be read.
    struct Source(ScanInfo, Vec<f64>, u64);

    impl ScanSource for Source {
        fn info(&self) -> &ScanInfo {
            &self.0
        }

        fn next_scan(&mut self) -> Option<NextScan> {
            let (index, stamp) = (self.2, *self.1.get(self.2 as usize)?);
            self.2 += 1;
            let damaged = || ScanError::Format { name: "scan".into(), what: "damaged".into() };
            let scan = if stamp.is_nan() { Err(damaged()) } else { Ok(Scan { stamp, ..Scan::default() }) };
            Some(NextScan { index, stamp, scan })
        }
    }

    fn read_all(stamps: Vec<f64>) -> (Vec<f64>, usize, Vec<String>) {
        let info = ScanInfo {
            path: "walk".into(),
            kind: "scans".into(),
            count: None,
            duration: None,
            is_kitti: false,
            facts: Vec::new(),
        };
        let mut source = ForwardScans::new(Box::new(Source(info, stamps, 0)));
        let all: Vec<NextScan> = std::iter::from_fn(|| source.next_scan()).collect();
        assert!(all.windows(2).all(|pair| pair[0].index + 1 == pair[1].index));
        let left_out = all.iter().filter(|next| next.scan.is_err()).count();
        let good = all.iter().filter_map(|next| next.scan.as_ref().ok().map(|scan| (scan.stamp, next.stamp)));
        let good: Vec<f64> = good.inspect(|(a, b)| assert_eq!(a, b)).map(|(stamp, _)| stamp).collect();
        assert!(good.is_sorted(), "{good:?}");
        (good, left_out, source.remarks())
    }

    #[test]
    fn scans_have_a_monotone_time() {
        let steady = |from: f64, count: u32| (0..count).map(move |i| from + 0.1 * f64::from(i));
        let mut future: Vec<f64> = steady(10.0, 80).collect();
        (future[20], future[50]) = (1e6, f64::NAN);
        let (good, left_out, warnings) = read_all(future);
        assert_eq!((good.len(), left_out, warnings.len()), (78, 2, 0));
        let (good, left_out, warnings) = read_all(steady(10.0, 40).chain(steady(2.0, 40)).collect());
        assert_eq!((good.len(), left_out), (80, 0));
        assert!(warnings[0].contains("set back by 12.0 s at frame 40"), "{warnings:?}");
        assert_eq!(read_all(vec![3.0; 80]).0.len(), 1);
        assert_eq!(read_all(Vec::new()).0.len(), 0);
    }
}
