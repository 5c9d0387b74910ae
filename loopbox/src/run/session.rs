//! A run as it was asked for: one map after another, until the source ends, the user stops it, or nobody wants a new
//! one.

use crate::describing::Describer;
use crate::listeners::Listeners;
use crate::run::Progress;
use crate::run::fragments;
use crate::run::lens_check::{GivenLens, LensCheck};
use crate::run::output::Output;
use crate::run::recognising::Recogniser;
use crate::run::record::{RunRecord, Setup};
use crate::run::resuming::{Kept, places};
use crate::run::revisits;
use crate::run::runtime::{Feed, Run};
use crate::run::saving::{self, Form, Saver};
use crate::run::surface_judge::SurfaceJudge;
use crate::swapping::SwapFiles;
use anyhow::{Context, Result, anyhow};
use geometry::Image;
use map::AgentInfo;
use slam_direct::{Atlas, ResumeMode};
use sources::Stop;
use sources::ahead::Ahead;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use view::watch::Watch;

/// What the maps of a run have in common.
pub struct Session<'a> {
    /// Who maps.
    pub about: AgentInfo,
    /// The source, the camera and the parameters.
    pub setup: Setup,
    /// Whether the keyframes' features are found beside tracking.
    pub features: bool,
    /// Whether nobody looks after the run (see [`RunOptions::unattended`](super::RunOptions::unattended)).
    pub unattended: bool,
    /// The form of results.
    pub form: Form,
    /// The user's wish to stop.
    pub stop: &'a Stop,
    /// Where progress is shown.
    pub progress: &'a dyn Progress,
    /// Which pixels of the images are not to be used, where somebody has said so.
    pub unused: Option<Image<bool>>,
    /// The map of an earlier run that the first map goes on in.
    pub kept: Option<Kept>,
    /// The lens, where it is to be checked whether it is the one of the images.
    pub lens: Option<GivenLens>,
    /// Who are told how the maps grow.
    pub listeners: Listeners,
    /// Where keyframes are kept that are too many for memory.
    pub swap: Arc<SwapFiles>,
}

/// The last map of a run.
pub struct Mapped {
    /// The folder of its results.
    pub folder: PathBuf,
    /// Its numbers.
    pub record: RunRecord,
    /// Why a live source ended though nobody wished it.
    pub failure: Option<String>,
    /// Why what was tracked is not in the map that was to be gone on in.
    pub apart: Option<String>,
}

impl Session<'_> {
    /// Tracks and maps what comes from `ahead` and writes the results.
    ///
    /// # Errors
    /// When nothing could be tracked, or results cannot be written.
    pub fn run(&self, mut output: Output, ahead: &Ahead, watch: &mut Watch) -> Result<Mapped> {
        let first = output.folder().to_owned();
        let saver = Saver::new(self.about.clone(), self.form);
        let save = |run: &Run, output: &Output, watch: &Watch| {
            let map = run.snapshot(&self.about);
            let record = run.record(&self.setup, ahead, false, std::slice::from_ref(&map));
            saver.save(output.folder(), map, record, watch.notifier());
        };
        let mut identity = self.about.identity;
        let mut next = self.kept.as_ref();
        let mut dropped_before = 0;
        loop {
            watch.folder(output.folder());
            let kept = next.take();
            let atlas = match kept {
                Some(kept) => kept.atlas(&self.setup.params)?,
                None => Atlas::new(self.setup.camera, places, self.setup.params.clone())?,
            };
            let recogniser =
                if self.setup.params.mapping.lag > 0 { Recogniser::in_time() } else { Recogniser::default() };
            let swap = Arc::<SwapFiles>::clone(&self.swap);
            let atlas = atlas.recognising(Box::new(recogniser)).swapping_to(swap);
            let atlas = atlas.judge_by(Arc::new(SurfaceJudge));
            let atlas = match &self.unused {
                Some(unused) => atlas.with_mask(unused)?,
                None => atlas,
            };
            let localises = kept.is_some_and(|kept| kept.mode == ResumeMode::Localising);
            // Who only localises begins anew in the same map.
            next = kept.filter(|_| localises);
            let describer = (self.features && !localises)
                .then(Describer::start)
                .transpose()
                .context("cannot start a thread")?;
            let check = self.lens.as_ref().filter(|_| !localises).map(|lens| LensCheck::new(lens.clone()));
            let run = Run::new(atlas, self.setup.camera, identity, dropped_before);
            let run = run.with(describer, check).within(kept);
            let run = run.with_listeners(self.listeners.clone()).left_alone(self.unattended);
            let feed = Feed { ahead, stop: self.stop, progress: self.progress };
            let run = run.track(feed, &mut output, watch, &save)?;
            let restart = run.is_to_restart();
            identity = run.next_identity();
            let failure = run.failure().map(str::to_owned);
            let tracked = self.write(run, ahead, &mut output)?;
            if !restart {
                let folder = output.folder().to_owned();
                let failure = failure.or(saver.end().err().map(|error| error.to_string()));
                let (record, apart) = tracked?;
                return Ok(Mapped { folder, record, failure, apart });
            }
            if let Ok((record, _)) = tracked {
                self.progress.mapped(&record, output.folder());
                output = self.next_output(&first, output.folder(), watch)?;
            }
            watch.restart();
            dropped_before = ahead.dropped();
        }
    }

    /// Writes the results of one map. The inner error says why there is none, what comes with the numbers why it is not
    /// the one that was gone on in.
    fn write(
        &self,
        mut run: Run,
        ahead: &Ahead,
        output: &mut Output,
    ) -> Result<Result<(RunRecord, Option<String>)>> {
        let leaves = run.leaves_its_maps(self.stop);
        let mut maps = run.maps(&self.about, !leaves);
        let mut revisits = Vec::new();
        if !leaves {
            if self.features && !run.localises() {
                let closing = &self.setup.params.closing;
                let closed = maps.into_iter().map(|map| revisits::closed(map, closing, self.progress));
                let of_maps: Vec<_>;
                (maps, of_maps) = closed.unzip();
                revisits = of_maps.concat();
            }
            maps = fragments::joined(maps, |map| run.holds_what_moves(map), self.progress);
        }
        // Where nobody looks, what it went on in may not be anywhere else by now.
        let apart = if self.unattended { None } else { run.leave_out_kept(&mut maps) };
        let mut record = run.record(&self.setup, ahead, self.stop.requested(), &maps);
        record.revisits = revisits;
        if record.frames.tracked == 0 {
            output.fail(&record)?;
            let why = run.failure().map_or_else(|| run.why_nothing_was_tracked(), str::to_owned);
            return Ok(Err(anyhow!(
                "{}: no frame could be tracked: {why}",
                self.setup.source.path.display()
            )));
        }
        if !run.localises() {
            let own = run.own_maps(&maps);
            self.listeners.notify(|listener| listener.ended(&own));
        }
        self.progress.stage("writing the results");
        let written = match maps.first() {
            _ if leaves && self.unattended => output.leave(),
            Some(map) if leaves => output.finish_grown(map, &mut record, self.form.format),
            Some(map) if run.localises() => output.finish_localised(map, &mut record, self.form.format),
            _ => {
                let trajectories: Vec<_> = maps.iter().map(|map| run.trajectory(map)).collect();
                output.finish(&maps, &trajectories, &mut record, self.form.format, self.form.max_variance)
            }
        };
        match run.failure() {
            Some(failure) => written.with_context(|| failure.to_owned())?,
            None => written?,
        }
        Ok(Ok((record, apart)))
    }

    /// A folder for the next map.
    fn next_output(&self, first: &Path, before: &Path, watch: &Watch) -> Result<Output> {
        let output =
            Output::create(&saving::next_folder(first), self.about.clone(), &self.setup.source.path, false)?;
        watch.notifier()(format!("a new map; the one before is in {}", before.display()));
        Ok(output)
    }
}
