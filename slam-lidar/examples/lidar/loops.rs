//! Loops closed and refused, with their errors.

use crate::Failure;
use crate::truth::{Recording, ate};
use slam_lidar::mapping::{Agent, Loop, MappingParams};
use std::path::Path;
use std::time::Instant;

/// Maps a recording and prints a line a loop and one of errors.
pub fn run(path: &Path) -> Result<(), Failure> {
    let recording = Recording::open(path)?;
    let mut agent = Agent::new(MappingParams::default());
    let (mut tracked, mut slowest) = (Vec::new(), 0.0f64);
    for file in recording.folder.files() {
        let scan = recording.folder.read(file)?;
        let begin = Instant::now();
        let (sweep, closed) = agent.take(&scan)?;
        if closed.is_some() {
            slowest = slowest.max(begin.elapsed().as_secs_f64());
        }
        tracked.push((sweep.instant, sweep.world_from_sensor));
    }
    let describe = |found: &Loop, what: &str| {
        let at = |keyframe: usize| recording.at(agent.keyframes()[keyframe].instant);
        let (Some(from), Some(to)) = (at(found.from), at(found.to)) else { return };
        let error = (from.inverse() * to).inverse() * found.alignment.target_from_source;
        println!(
            "{what} {} {}: error {:.3} m {:.2} deg, {:.3?}",
            found.from,
            found.to,
            error.translation.norm(),
            error.rotation.angle().to_degrees(),
            found.alignment.evidence
        );
    };
    agent.loops().iter().for_each(|found| describe(found, "closed"));
    for refused in agent.refused() {
        describe(&refused.candidate, &format!("refused ({})", refused.line));
    }
    let (before, after) = (ate(&recording.pairs(&tracked))?.0, ate(&recording.pairs(&agent.trajectory()))?.0);
    println!(
        "{}: {} keyframes, {} loops, {} refused, ATE {before:.4} -> {after:.4} m, slowest loop {slowest:.2} s",
        path.display(),
        agent.keyframes().len(),
        agent.loops().len(),
        agent.refused().len()
    );
    Ok(())
}
