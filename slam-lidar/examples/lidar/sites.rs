//! Ray-cast drives through tunnels, fields, corridors, streets and halls, with exact truth.

use crate::Failure;
use crate::oracle::Oracle;
use crate::truth::ate;
use geometry::Se3;
use loopbox_tests::lidar::PERIOD;
use loopbox_tests::lidar_open::{Drive, drives, returns};
use nalgebra::Vector3;
use scans::Scan;
use slam_lidar::loop_verdict::LoopTest;
use slam_lidar::mapping::{Agent, Loop, MappingParams};
use slam_lidar::odometry::Guess;

/// A loop is wrong when it is farther off, metres.
const WRONG: f64 = 0.3;

/// Lot 0 is there to set limits on, lot 1 to measure by; of all drives those whose names and sensors hold one of the words.
pub fn run(arguments: &[String]) -> Result<(), Failure> {
    let lot: u64 = arguments.first().map_or(Ok(0), |lot| lot.parse())?;
    let wanted: Vec<&str> = arguments.get(1).map_or(vec![""], |words| words.split('|').collect());
    println!(
        "| drive | scans with a pose | path m | ATE m | most off m | by odometry | losses | loops | of these wrong | refused by drift, \
         of these right | by rivals, right | open m | of these reported | reported elsewhere | guessed m | may err m |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for drive in drives(lot).into_iter().chain(returns(lot)) {
        let name = format!("{}, {:?}", drive.name, drive.sensor);
        if wanted.iter().any(|word| name.contains(word)) {
            println!("| {name} | {} |", one(&drive)?);
        }
    }
    Ok(())
}

/// Metres of a drive whose scans do not tell the motion.
#[derive(Default)]
struct Metres {
    /// Open by the true normals, and of these reported as guessed.
    open: [f64; 2],
    /// Reported as guessed and not open.
    elsewhere: f64,
    /// As the odometry counts them, and what they may err by.
    guessed: (f64, f64),
}

impl Metres {
    fn add(&mut self, open: Option<Vector3<f64>>, step: &Vector3<f64>, guess: &Guess) {
        let is_reported = guess.directions > 0;
        match open {
            Some(axis) => {
                let metres = step.dot(&axis).abs();
                self.open[0] += metres;
                self.open[1] += if is_reported { metres } else { 0.0 };
            }
            None => self.elsewhere += if is_reported { step.norm() } else { 0.0 },
        }
        self.guessed = (self.guessed.0 + guess.metres, self.guessed.1.max(guess.deviation));
    }
}

/// Maps a drive; the map of most scans, how often the sensor was lost, and what is guessed.
fn mapped(drive: &Drive) -> Result<(Agent, usize, Metres), Failure> {
    let params = MappingParams::default();
    let mut agent = Agent::new(params);
    let (mut maps, mut lost, mut metres) = (Vec::new(), 0, Metres::default());
    let (mut last, mut oracle) = (drive.path.at(0.5 * PERIOD), None);
    for stamp in (0..drive.scans()).map(|index| index as f64 * PERIOD) {
        let sensed = drive.sensor.sweep(&drive.boxes, |time| drive.path.at(time), stamp);
        let open = oracle.get_or_insert_with(|| Oracle::new(&sensed)).open(&sensed, drive, stamp);
        let truth = drive.path.at(stamp + 0.5 * PERIOD);
        let step = truth.translation - last.translation;
        last = truth;
        let scan = Scan {
            stamp,
            points: sensed.iter().map(|s| s.point).collect(),
            times: sensed.iter().map(|s| s.time).collect(),
            ..Scan::default()
        };
        let sweep = agent.take(&scan)?.0;
        metres.add(open, &step, &sweep.guess);
        lost = if sweep.lost { lost + 1 } else { 0 };
        if lost == 3 {
            maps.push(std::mem::replace(&mut agent, Agent::new(params)));
            agent.take(&scan)?;
            lost = 0;
        }
    }
    maps.push(agent);
    let losses = maps.len() - 1;
    let longest = maps.into_iter().max_by_key(|agent| agent.sweeps().len());
    Ok((longest.unwrap_or_else(|| Agent::new(params)), losses, metres))
}

/// How far poses are off at most when the first is held to the truth, metres.
fn most_off(pairs: &[(Se3, Se3)]) -> f64 {
    let Some((found, truth)) = pairs.first() else { return f64::NAN };
    let world = *truth * found.inverse();
    let off = pairs.iter().map(|(found, truth)| ((world * *found).translation - truth.translation).norm());
    off.fold(0.0, f64::max)
}

fn one(drive: &Drive) -> Result<String, Failure> {
    let (agent, losses, metres) = mapped(drive)?;
    let pairs = |poses: &[(f64, Se3)]| -> Vec<(Se3, Se3)> {
        poses.iter().map(|(time, pose)| (*pose, drive.path.at(*time))).collect()
    };
    let (map, odometry) = (pairs(&agent.trajectory()), pairs(&agent.odometry()));
    let path: f64 = map.windows(2).map(|two| (two[1].1.translation - two[0].1.translation).norm()).sum();
    let is_wrong = |found: &Loop| {
        let [from, to] = [found.from, found.to].map(|k| drive.path.at(agent.keyframes()[k].instant));
        let off = (from.inverse() * to).inverse() * found.alignment.target_from_source;
        off.translation.norm() > WRONG
    };
    let refused = |test: LoopTest| {
        let by = agent.refused().iter().filter(|refused| refused.line.test == test);
        let right = by.clone().filter(|refused| !is_wrong(&refused.candidate)).count();
        format!("{}, {right}", by.count())
    };
    Ok(format!(
        "{} of {} | {path:.0} | {:.3} | {:.2} | {:.2} | {losses} | {} | {} | {} | {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1}",
        map.len(),
        drive.scans(),
        ate(&map).map_or(f64::NAN, |found| found.0),
        most_off(&map),
        most_off(&odometry),
        agent.loops().len(),
        agent.loops().iter().filter(|found| is_wrong(found)).count(),
        refused(LoopTest::Drift),
        refused(LoopTest::Rivals),
        metres.open[0],
        metres.open[1],
        metres.elsewhere,
        metres.guessed.0,
        metres.guessed.1,
    ))
}
