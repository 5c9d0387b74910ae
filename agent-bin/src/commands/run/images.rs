//! `loopbox run` over images.

use super::RunArgs;
use crate::commands::publishing;
use crate::commands::watching::{Preparing, RunPage};
use crate::progress::Console;
use anyhow::{Result, bail};
use loopbox::open::recording_name;
use loopbox::run::{PreparedRun, Progress, RunOptions};
use sources::{FrameSource, Stop};

/// A run over images, and its page from the first moment until the user has seen enough.
///
/// # Errors
/// As [`execute`](super::execute).
pub(super) fn over_images(args: &RunArgs, stop: &Stop) -> Result<()> {
    let options = args.options()?;
    let source = args.open()?;
    let info = source.info();
    let title = options.name.clone().unwrap_or_else(|| recording_name(&info.path));
    let page = args.view.page(&title, info.frame_count)?;
    let result = mapped(args, (source, options), &page, stop);
    page.end(&result, stop);
    result
}

/// The run, shown on `page`.
fn mapped(
    args: &RunArgs,
    (mut source, mut options): (Box<dyn FrameSource>, RunOptions),
    page: &RunPage,
    stop: &Stop,
) -> Result<()> {
    let (console, fov) = (Console::new(args.display(), None).with_json(args.json), args.lens.fov);
    let progress = Preparing { console: &console, page };
    match args.recording() {
        Some(recording) => options.without_calibration(source.info(), recording, fov, stop, &progress)?,
        None => options.live_without_calibration(source.as_mut(), fov, stop, &progress)?,
    }
    drop(console);
    let prepared = PreparedRun::new(source, options)?;
    let progress = Console::new(args.display(), prepared.frame_count()).with_json(args.json);
    if prepared.is_given_a_calibration() {
        progress.note(&prepared.calibration());
    }
    prepared.problems().iter().for_each(|problem| progress.warn(problem));
    #[cfg(feature = "fleet")]
    let fleet = args.pairing.start(args.out(), args.quiet)?;
    let watched = |about: &_, frames, recording| {
        let watch = args.view.start(page, about, frames, recording)?;
        #[cfg(feature = "fleet")]
        if let Some(fleet) = &fleet {
            fleet.report_to(watch.neighbourhood());
        }
        Ok(watch)
    };
    #[cfg(feature = "fleet")]
    let prepared = match &fleet {
        Some(fleet) => prepared.with_listener(fleet.publisher()?),
        None => prepared,
    };
    let (prepared, publishing) = match args.publishing.start()? {
        Some((follower, publishing)) => (prepared.with_listener(follower), Some(publishing)),
        None => (prepared, None),
    };
    let mapped = prepared.go(watched, stop, &progress);
    publishing.map(|publishing| publishing::end(publishing, args.quiet)).transpose()?;
    let mapped = mapped?;
    #[cfg(feature = "fleet")]
    if let Some(fleet) = fleet {
        args.pairing.end(fleet, args.out(), stop, args.quiet)?;
    }
    match (mapped.failure, mapped.apart) {
        (Some(failure), _) => bail!("the run ended early, what was tracked is saved: {failure}"),
        (None, Some(apart)) => bail!("{apart}"),
        (None, None) => args.judge(mapped.record.frames.tracked_share),
    }
}
