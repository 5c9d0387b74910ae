//! What is due and when, by what was done last and how long that took. It is told the time.

use crate::fleet::common_maps::WRITE_INTERVAL;
use std::time::{Duration, Instant};

/// Time between merges at the least, and in terms of that which one took while maps grow.
const PAUSE: Duration = Duration::from_millis(250);
const PAUSE_FACTOR: u32 = 2;
/// How long whole maps wait where parts may give an agent its place.
const WHOLE_MAPS_INTERVAL: Duration = Duration::from_secs(3);
/// How often is told what moves nobody.
const REPORT_INTERVAL: Duration = Duration::from_secs(2);
/// Time between joint pose graphs in terms of that which one takes, while pairs are left.
const OPTIMISE_FACTOR: u32 = 10;
/// How long nothing is tried again after the disk was full.
const RETRY: Duration = Duration::from_secs(5);

/// When what was done last.
#[derive(Clone, Copy, Debug)]
pub(super) struct Schedule {
    begun: Instant,
    merged: Done,
    published: Instant,
    optimised: Done,
    written: Option<Instant>,
    /// When the disk was found full.
    full: Option<Instant>,
    /// Whether parts of maps were looked at since whole maps were due.
    were_parts_last: bool,
    /// Whether there is more to do at once, whatever comes.
    pub has_more: bool,
}

/// When something was over, and how long it took.
#[derive(Clone, Copy, Debug)]
struct Done {
    at: Instant,
    took: Duration,
}

/// What there is to do.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Load {
    /// Whether all runs are over and all of their maps is here.
    pub is_over: bool,
    /// Whether no run goes on beside the merging, which gives way to it.
    pub is_alone: bool,
    /// Whether pairs of whole maps are left to be looked at.
    pub is_left: bool,
    /// Whether some of these may give an agent its place.
    pub may_join: bool,
    /// Whether parts of maps may.
    pub may_place: bool,
    /// Whether such parts are likely to be there in a moment.
    pub is_coming: bool,
}

impl Load {
    /// Whether nothing is begun just now, for what is there gives nobody a place and what gives one comes in a moment.
    pub fn is_deferred(&self) -> bool {
        self.is_coming && self.is_alone && !self.is_over && !self.may_join && !self.may_place
    }
}

impl Schedule {
    /// Of one that begins.
    pub fn new(now: Instant) -> Self {
        let nothing = Done { at: now, took: Duration::ZERO };
        let (written, full, were_parts_last, has_more) = Default::default();
        Self {
            begun: now,
            merged: nothing,
            published: now,
            optimised: nothing,
            written,
            full,
            were_parts_last,
            has_more,
        }
    }

    /// How long it is not merged after it was.
    pub fn pause(&self, load: Load) -> Duration {
        // Who waits for runs that are over takes no time from any, and no more does a station that has pairs left which may
        // give an agent its place.
        match load.is_left && (load.is_over || load.is_alone && load.may_join) {
            true => Duration::ZERO,
            false if load.is_over => PAUSE,
            false => PAUSE.max(self.merged.took * PAUSE_FACTOR),
        }
    }

    /// Whether whole maps may be merged: they and parts in turns, so that neither waits for the other for long; whole maps for
    /// longer where an agent waits for the place that parts may give it.
    pub fn may_merge(&self, load: Load, now: Instant) -> bool {
        let interval = if load.may_place && !load.may_join { WHOLE_MAPS_INTERVAL } else { Duration::ZERO };
        since(self.merged.at, now) >= self.pause(load).max(interval)
    }

    /// Whether parts that are ready are looked at next, where whole maps are due or are not: in turns with these.
    pub fn are_parts_next(&mut self, are_whole_due: bool) -> bool {
        !std::mem::take(&mut self.were_parts_last) || !are_whole_due
    }

    /// Parts are looked at.
    pub fn parts_looked_at(&mut self) {
        (self.were_parts_last, self.has_more) = (true, true);
    }

    /// Whether what moves nobody is to be told.
    pub fn may_report(&self, now: Instant) -> bool {
        since(self.published, now) >= REPORT_INTERVAL
    }

    /// Whether the common map is to be written while maps grow.
    pub fn may_write(&self, is_left: bool, now: Instant) -> bool {
        match (is_left, self.written) {
            (false, None) => true,
            (_, written) => since(written.unwrap_or(self.begun), now) > WRITE_INTERVAL,
        }
    }

    /// Whether the joint pose graph had its time of rest, which is longer while pairs are left.
    pub fn may_optimise(&self, is_left: bool, now: Instant) -> bool {
        let factor = if is_left { OPTIMISE_FACTOR } else { PAUSE_FACTOR };
        since(self.optimised.at, now) >= self.optimised.took * factor
    }

    /// Whether the disk was full a short while ago.
    pub fn waits_for_room(&self, now: Instant) -> bool {
        self.full.is_some_and(|full| since(full, now) < RETRY)
    }

    /// Whole maps were merged, from `begun` on.
    pub fn merged(&mut self, begun: Instant, now: Instant) {
        self.merged = Done { at: now, took: since(begun, now) };
    }

    /// What was found was told.
    pub fn mark_published(&mut self, now: Instant) {
        self.published = now;
    }

    /// The joint pose graph was made, which took so long.
    pub fn optimised(&mut self, took: Duration, now: Instant) {
        self.optimised = Done { at: now, took };
    }

    /// The common map was written.
    pub fn written(&mut self, now: Instant) {
        self.written = Some(now);
    }

    /// The disk had no room.
    pub fn found_full(&mut self, now: Instant) {
        self.full = Some(now);
    }

    /// What is not written is written next, whenever that was done last.
    pub fn request_write(&mut self) {
        self.written = None;
    }
}

fn since(then: Instant, now: Instant) -> Duration {
    now.saturating_duration_since(then)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);
    const S: Duration = Duration::from_secs(1);

    #[test]
    fn between_merges_is_a_pause_unless_somebody_may_get_a_place_or_all_runs_are_over() {
        let start = Instant::now();
        let mut table = Schedule::new(start);
        let arriving = Load { is_alone: true, ..Load::default() };
        assert!(!table.may_merge(arriving, start) && table.may_merge(arriving, start + 250 * MS));
        table.merged(start, start + S);
        // Twice the second that it took.
        assert!(!table.may_merge(arriving, start + 2999 * MS) && table.may_merge(arriving, start + 3 * S));
        let over = Load { is_over: true, ..arriving };
        assert!(!table.may_merge(over, start + 1249 * MS) && table.may_merge(over, start + 1250 * MS));
        let joining = Load { is_left: true, may_join: true, ..arriving };
        assert!(table.may_merge(joining, start + S));
        // Beside a run it takes its time from that.
        assert!(!table.may_merge(Load { is_alone: false, ..joining }, start + 2 * S));
        assert!(table.may_merge(Load { is_left: true, ..over }, start + S));
    }

    #[test]
    fn whole_maps_wait_for_parts_that_give_places_but_not_for_good() {
        let start = Instant::now();
        let table = Schedule::new(start);
        let parts = Load { is_over: true, is_left: true, may_place: true, ..Load::default() };
        assert!(!table.may_merge(parts, start + 2999 * MS) && table.may_merge(parts, start + 3 * S));
        assert!(table.may_merge(Load { may_join: true, ..parts }, start));
    }

    #[test]
    fn parts_and_whole_maps_are_in_turns_where_both_are_due() {
        let mut table = Schedule::new(Instant::now());
        assert!(table.are_parts_next(true) && !table.has_more);
        table.parts_looked_at();
        assert!(table.has_more && !table.are_parts_next(true) && table.are_parts_next(true));
        table.parts_looked_at();
        assert!(table.are_parts_next(false) && table.are_parts_next(true));
    }

    #[test]
    fn a_station_begins_nothing_that_gives_nobody_a_place_while_what_gives_one_comes() {
        let coming = Load { is_coming: true, is_alone: true, is_left: true, ..Load::default() };
        assert!(coming.is_deferred());
        let begun = [
            Load { is_coming: false, ..coming },
            Load { is_alone: false, ..coming },
            Load { is_over: true, ..coming },
            Load { may_join: true, ..coming },
            Load { may_place: true, ..coming },
        ];
        assert!(begun.iter().all(|load| !load.is_deferred()));
    }

    #[test]
    fn a_map_is_written_at_once_and_then_now_and_then() {
        let start = Instant::now();
        let mut table = Schedule::new(start);
        assert!(table.may_write(false, start) && !table.may_write(true, start));
        assert!(!table.may_write(true, start + 30 * S) && table.may_write(true, start + 31 * S));
        table.written(start + S);
        assert!(!table.may_write(false, start + 31 * S) && table.may_write(false, start + 32 * S));
        table.request_write();
        assert!(table.may_write(false, start + 2 * S));
    }

    #[test]
    fn the_joint_pose_graph_rests_for_longer_while_pairs_are_left() {
        let start = Instant::now();
        let mut table = Schedule::new(start);
        assert!(table.may_optimise(true, start));
        table.optimised(2 * S, start);
        assert!(!table.may_optimise(true, start + 19 * S) && table.may_optimise(true, start + 20 * S));
        assert!(!table.may_optimise(false, start + 3 * S) && table.may_optimise(false, start + 4 * S));
    }

    #[test]
    fn a_full_disk_is_written_to_again_after_some_seconds() {
        let start = Instant::now();
        let mut table = Schedule::new(start);
        assert!(!table.waits_for_room(start));
        table.found_full(start);
        assert!(table.waits_for_room(start + 4 * S) && !table.waits_for_room(start + 5 * S));
        assert!(table.may_report(start + 2 * S) && !table.may_report(start + S));
        table.mark_published(start + S);
        assert!(!table.may_report(start + 2 * S));
    }
}
