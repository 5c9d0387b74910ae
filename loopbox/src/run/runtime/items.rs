//! What a source hands on, and what a run does with it.

use super::{Feed, Run, guarded};
use crate::run::Progress;
use crate::run::output::Output;
use anyhow::Result;
use slam_direct::Frame;
use sources::ahead::Item;
use sources::notice::Notice;
use std::ops::ControlFlow;
use std::time::Instant;
use view::watch::Watch;

impl Run<'_> {
    /// Processes a frame, and lets the results grow by it; `Break` where the run cannot go on.
    pub(super) fn take_frame(
        &mut self,
        (frame, taken): (Frame, Option<Instant>),
        Feed { ahead, progress, .. }: Feed,
        output: &mut Output,
        watch: &mut Watch,
    ) -> Result<ControlFlow<()>> {
        let process = || self.process(frame, taken, progress, ahead.dropped(), watch);
        let deltas = match guarded("tracking", process) {
            Ok(deltas) => deltas?,
            Err(why) => {
                self.broken = Some(why);
                return Ok(ControlFlow::Break(()));
            }
        };
        progress.lost(ahead.dropped(), ahead.missed());
        self.describe(&deltas);
        self.notify_changed(&deltas);
        output.identify(self.identity_of(self.fragment));
        if !self.localises()
            && let Err(error) = output.grow(self.fragment, self.map(), deltas)
        {
            return Ok(self.fail(&error));
        }
        self.waits_for_room = report_room(self.waits_for_room, output.waits_for_room(), progress);
        self.check_lens(progress);
        if self.milestones.is_due(self.wall_s) {
            progress.note(&self.standing(ahead).text());
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Tells what a live source notices; while it is away, what has grown is on the disk.
    pub(super) fn take_notice(
        &mut self,
        notice: &Notice,
        progress: &dyn Progress,
        output: &mut Output,
    ) -> ControlFlow<()> {
        progress.notice(notice);
        match notice {
            Notice::Gone(_) => output.flush().map_or_else(|error| self.fail(&error), ControlFlow::Continue),
            _ => ControlFlow::Continue(()),
        }
    }

    /// Tells what is no frame.
    pub(super) fn note(&mut self, item: Item, progress: &dyn Progress) -> ControlFlow<()> {
        match item {
            Item::Skipped(skip) => {
                progress.skipped(&skip);
                *self.skipped.entry(skip.reason).or_default() += 1;
                self.first_skip.get_or_insert_with(|| skip.detail.clone());
            }
            Item::Warning(text) => progress.warn(&text),
            Item::Failed(reason) => self.failure = Some(reason),
            Item::Frame(..) | Item::Notice(_) | Item::Nothing => {}
        }
        ControlFlow::Continue(())
    }

    /// Results cannot be written any more.
    fn fail(&mut self, error: &anyhow::Error) -> ControlFlow<()> {
        self.failure = Some(format!("{error:#}"));
        ControlFlow::Break(())
    }
}

/// Tells when the map begins and ends to wait for room on the disk; gives whether it does.
fn report_room(was_waiting: bool, is_waiting: bool, progress: &dyn Progress) -> bool {
    match (was_waiting, is_waiting) {
        (false, true) => {
            progress.warn_of("disk", "the disk is full: the map grows in memory until there is room")
        }
        (true, false) => progress.note_of("disk", "the disk has room again: all of the map is written"),
        _ => {}
    }
    is_waiting
}
