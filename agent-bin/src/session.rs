//! A run as it was asked for: one map after another, until the source ends, the user stops it, or nobody wants a new
//! one.

use crate::ahead::Ahead;
use crate::output::Output;
use crate::progress::Progress;
use crate::record::RunRecord;
use crate::runtime::{Run, Stop};
use crate::saving::{self, Form, Saver};
use crate::sources::SourceInfo;
use crate::watch::Watch;
use anyhow::{Result, anyhow};
use geometry::Pinhole;
use map::AgentInfo;
use place_recog::ThumbnailIndex;
use slam_direct::{Agent, Params};
use std::path::{Path, PathBuf};

/// What the maps of a run have in common.
pub struct Session<'a> {
    /// Who maps.
    pub about: AgentInfo,
    /// What is known of the source.
    pub source: SourceInfo,
    /// The camera of the corrected images.
    pub camera: Pinhole,
    /// How it maps.
    pub params: Params,
    /// The form of results.
    pub form: Form,
    /// The user's wish to stop.
    pub stop: &'a Stop,
    /// Where progress is shown.
    pub progress: &'a Progress,
}

/// The last map of a run.
pub struct Mapped {
    /// The folder of its results.
    pub folder: PathBuf,
    /// Its numbers.
    pub record: RunRecord,
    /// Why a live source ended though nobody wished it.
    pub failure: Option<String>,
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
            let record = run.record(&self.source, self.camera, ahead, false);
            saver.save(output.folder(), run.snapshot(), record, watch.teller());
        };
        loop {
            watch.folder(output.folder());
            let agent = Agent::new(self.camera, Box::new(ThumbnailIndex::default()), self.params.clone())?;
            let run = Run::track(agent, ahead, self.stop, self.progress, &mut output, watch, &save)?;
            let restart = run.is_to_restart();
            let failure = run.failure().map(str::to_owned);
            let tracked = self.write(run, ahead, &mut output)?;
            if !restart {
                return Ok(Mapped { folder: output.folder().to_owned(), record: tracked?, failure });
            }
            if let Ok(record) = tracked {
                self.progress.finish(&record, &output.folder().display().to_string());
                output = self.next_output(&first, output.folder(), watch)?;
            }
            watch.begin_anew();
        }
    }

    /// Writes the results of one map. The inner error says why there is none.
    fn write(&self, run: Run, ahead: &Ahead, output: &mut Output) -> Result<Result<RunRecord>> {
        let record = run.record(&self.source, self.camera, ahead, self.stop.requested());
        if record.frames.tracked == 0 {
            output.numbers(&record)?;
            let failure = run.failure().map(|failure| format!("\n{failure}")).unwrap_or_default();
            let why = run.why_nothing_was_tracked() + &failure;
            return Ok(Err(anyhow!("{}: no frame could be tracked: {why}", self.source.path.display())));
        }
        self.progress.stage("writing the results");
        output.finish(&mut run.into_map(), &record, self.form.format, self.form.max_variance)?;
        Ok(Ok(record))
    }

    /// A folder for the next map.
    fn next_output(&self, first: &Path, before: &Path, watch: &Watch) -> Result<Output> {
        let output = Output::create(&saving::next_folder(first), self.about.clone())?;
        watch.teller()(format!("a new map; the one before is in {}", before.display()));
        Ok(output)
    }
}
