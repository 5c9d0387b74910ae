//! How good the trajectories of several agents are in one common frame.

use crate::align::alignment;
use crate::evaluation::Matched;
use crate::{AlignMode, EvalError, Evaluation, Options, Trajectory};
use geometry::Sim3;
use nalgebra::Vector3;
use serde::Serialize;

/// One of several agents.
#[derive(Clone, Debug)]
pub struct AgentTracks {
    /// Its estimated trajectory, in the frame and unit common to all agents.
    pub estimate: Trajectory,
    /// Its true trajectory, in the world common to all agents.
    pub truth: Trajectory,
    /// Times of its recording's frames, seconds, if they are known.
    pub frames: Option<Vec<f64>>,
}

/// All measures of several agents' estimates.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AgentsEvaluation {
    /// What was adjusted on the first agent alone: maps the estimates of all agents into the frame and unit
    /// of the ground truth.
    pub truth_from_estimate: Sim3,
    /// The agents in the order given.
    pub agents: Vec<AgentEvaluation>,
}

/// All measures of one of several agents.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AgentEvaluation {
    /// The measures after the alignment of the first agent.
    #[serde(flatten)]
    pub evaluation: Evaluation,
    /// How well the agent was merged with the first; `None` of the first itself, and where a path too short or
    /// too straight does not show it.
    pub merge: Option<MergeError>,
}

/// How wrong an agent stands to the first one in the common frame.
///
/// Both are aligned with their ground truths by a Sim(3) each (Umeyama 1991); if the merge were perfect the
/// two would be equal but for the agents' own errors. `rotation_deg` is as uncertain as the rotation about a path
/// that is nearly straight.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MergeError {
    /// By how much the agent is too large beside the first, percent; below 0 it is too small.
    pub scale_percent: f64,
    /// By how much it is turned, degrees, 0–180.
    pub rotation_deg: f64,
    /// How far its middle is from where it belongs, in the unit of the ground truth.
    pub offset: f64,
}

impl MergeError {
    /// The error of an agent from the similarities `truth_from_estimate` of the first one alone and of the
    /// agent alone; `middle` is the mean of its estimated positions.
    fn new(first: &Sim3, agent: &Sim3, middle: &Vector3<f64>) -> Self {
        Self {
            scale_percent: 100.0 * (first.scale / agent.scale - 1.0),
            rotation_deg: first.rotation.angle_to(&agent.rotation).to_degrees(),
            offset: (*first * *middle - *agent * *middle).norm(),
        }
    }
}

/// Compares several agents' estimates with their ground truths: `options.align` is found on the first agent
/// alone and applied to all, so that the errors of the others contain that of the merge.
///
/// # Errors
/// [`EvalError::Agent`] with the reason, [`EvalError::Stranger`] and [`EvalError::Mistaken`] among them;
/// [`EvalError::Setting`] without agents.
pub fn evaluate_agents(agents: Vec<AgentTracks>, options: &Options) -> Result<AgentsEvaluation, EvalError> {
    let tracks = agents.clone();
    let mut matched = Vec::with_capacity(agents.len());
    for (i, agent) in agents.into_iter().enumerate() {
        let AgentTracks { estimate, truth, frames } = agent;
        let found = Matched::new(estimate, truth, frames.as_deref(), options.max_diff);
        matched.push(found.map_err(|reason| of_agent(i, reason))?);
    }
    let Some(first) = matched.first() else {
        return Err(EvalError::Setting("there is no agent to evaluate".into()));
    };
    let truth_from_estimate =
        alignment(&first.pairs, options.align).map_err(|reason| of_agent(0, reason.into()))?;
    for (i, matched) in matched.iter().enumerate() {
        let strangeness = follows(matched).map_err(|reason| of_agent(i, reason))?;
        not_another_s(i, strangeness, &tracks, options).map_err(|reason| of_agent(i, reason))?;
    }
    let first_alone = alone(first);
    let measure = |(i, matched): (usize, &Matched)| {
        let evaluation =
            matched.measured(&truth_from_estimate, options).map_err(|reason| of_agent(i, reason))?;
        let own = if i == 0 { None } else { alone(matched) };
        let middle = middle(&matched.pairs.positions().0);
        let merge = first_alone.zip(own).map(|(first, own)| MergeError::new(&first, &own, &middle));
        Ok(AgentEvaluation { evaluation, merge })
    };
    let agents = matched.iter().enumerate().map(measure).collect::<Result<_, EvalError>>()?;
    Ok(AgentsEvaluation { truth_from_estimate, agents })
}

/// The similarity that fits one agent best; `None` where its path does not show it.
fn alone(matched: &Matched) -> Option<Sim3> {
    alignment(&matched.pairs, AlignMode::Sim3).ok()
}

/// An estimate whose error is this share of the spread of its truth, or more, says nothing about it: the best fit of
/// positions that have nothing to do with it shrinks them to the middle of the truth and comes near 1.
const STRANGE: f64 = 0.7;

/// An estimate whose error is this share of the spread of its truth, or less, is taken to be of it.
const OWN: f64 = 0.05;
/// One that fits another agent's truth so many times better is taken to be that agent's.
const BETTER: f64 = 4.0;

/// How far an estimate is from its truth, aligned alone and as a share of that truth's spread; 0 where its path does not show
/// it. Refuses one that has nothing to do with its truth, however it is turned, moved and scaled.
fn follows(matched: &Matched) -> Result<f64, EvalError> {
    let Some(truth_from_estimate) = alone(matched) else { return Ok(0.0) };
    let (estimated, truth) = matched.pairs.transformed(&truth_from_estimate).positions();
    let middle = middle(&truth);
    let rms = |squares: f64| (squares / truth.len().max(1) as f64).sqrt();
    let rmse = rms(estimated.iter().zip(&truth).map(|(a, b)| (a - b).norm_squared()).sum());
    let spread = rms(truth.iter().map(|p| (p - middle).norm_squared()).sum());
    if rmse >= STRANGE * spread { Err(EvalError::Stranger { rmse, spread }) } else { Ok(rmse / spread) }
}

/// Refuses an estimate that is so far from its own truth and fits another agent's better by far: the truths are mixed up.
fn not_another_s(
    own: usize,
    strangeness: f64,
    tracks: &[AgentTracks],
    options: &Options,
) -> Result<(), EvalError> {
    if strangeness <= OWN {
        return Ok(());
    }
    for (other, AgentTracks { truth, .. }) in tracks.iter().enumerate().filter(|(other, _)| *other != own) {
        let estimate = tracks[own].estimate.clone();
        let Ok(matched) = Matched::new(estimate, truth.clone(), None, options.max_diff) else { continue };
        if alone(&matched).is_some() && follows(&matched).is_ok_and(|there| BETTER * there < strangeness) {
            return Err(EvalError::Mistaken { other: other + 1 });
        }
    }
    Ok(())
}

/// The mean of positions.
fn middle(positions: &[Vector3<f64>]) -> Vector3<f64> {
    positions.iter().sum::<Vector3<f64>>() / positions.len().max(1) as f64
}

/// Names the agent.
fn of_agent(index: usize, reason: EvalError) -> EvalError {
    EvalError::Agent { number: index + 1, reason: Box::new(reason) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose;
    use geometry::Se3;
    use nalgebra::{SVector, UnitQuaternion};
    use proptest::prelude::*;

    /// A winding path that begins at `start`, 20 poses a second.
    fn path(start: f64) -> Trajectory {
        let times: Vec<f64> = (0..80).map(|i| start + f64::from(i) / 20.0).collect();
        let pose = |&t: &f64| {
            let position = Vector3::new(t, (1.3 * t).sin(), 0.4 * (0.7 * t).cos());
            Se3::new(UnitQuaternion::from_euler_angles(0.1 * t, 0.3 * (0.9 * t).sin(), 0.2), position).into()
        };
        Trajectory { world_from_camera: times.iter().map(pose).collect(), timestamps: Some(times) }
    }

    fn moved(trajectory: &Trajectory, motion: &Sim3) -> Trajectory {
        let poses: Vec<Pose> =
            trajectory.world_from_camera.iter().map(|pose| pose.transformed(motion)).collect();
        Trajectory { world_from_camera: poses, ..trajectory.clone() }
    }

    /// An agent whose estimate is the truth in another world, after a mistake made in the truth's.
    fn agent(start: f64, world_from_truth: &Sim3, mistake: &Sim3) -> AgentTracks {
        let truth = path(start);
        let estimate = moved(&truth, &(*world_from_truth * *mistake));
        AgentTracks { estimate, truth, frames: None }
    }

    fn similarity() -> impl Strategy<Value = Sim3> {
        prop::array::uniform7(-1.0f64..1.0).prop_map(|v| Sim3::exp(&SVector::<f64, 7>::from(v)))
    }

    proptest! {
        #[test]
        fn mistakes_of_a_merge_are_measured(world in similarity(), mistake in similarity()) {
            let agents = vec![agent(0.0, &world, &Sim3::identity()), agent(3.0, &world, &mistake)];
            let found = evaluate_agents(agents, &Options::default()).unwrap();
            prop_assert!((found.truth_from_estimate.scale * world.scale - 1.0).abs() < 1e-9);
            prop_assert!(found.agents[0].evaluation.ate.max < 1e-9);
            prop_assert_eq!(found.agents[0].merge, None);
            let merge = found.agents[1].merge.unwrap();
            prop_assert!((merge.scale_percent - 100.0 * (mistake.scale - 1.0)).abs() < 1e-6, "{:?}", merge);
            prop_assert!((merge.rotation_deg - mistake.rotation.angle().to_degrees()).abs() < 1e-5);
            let middle = middle(&path(3.0).world_from_camera.iter().map(|p| p.translation).collect::<Vec<_>>());
            prop_assert!((merge.offset - (mistake * middle - middle).norm()).abs() < 1e-8);
            let positions = path(3.0).world_from_camera.into_iter().map(|pose| pose.translation);
            let squares: Vec<f64> = positions.map(|p| (mistake * p - p).norm_squared()).collect();
            let rmse = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
            prop_assert!((found.agents[1].evaluation.ate.rmse - rmse).abs() < 1e-8);
        }
    }

    #[test]
    fn one_agent_is_evaluated_as_alone() {
        let mut one = agent(0.0, &Sim3::identity(), &Sim3::identity());
        one.estimate.world_from_camera.iter_mut().step_by(3).for_each(|pose| pose.translation.x += 0.1);
        let alone =
            crate::evaluate(one.estimate.clone(), one.truth.clone(), None, &Options::default()).unwrap();
        let found = evaluate_agents(vec![one], &Options::default()).unwrap();
        assert_eq!(found.agents, [AgentEvaluation { evaluation: alone, merge: None }]);
    }

    #[test]
    fn a_straight_path_shows_no_merge_but_errors() {
        let good = agent(0.0, &Sim3::identity(), &Sim3::identity());
        let mut straight = agent(2.0, &Sim3::identity(), &Sim3::identity());
        for pose in straight.truth.world_from_camera.iter_mut() {
            (pose.translation.y, pose.translation.z) = (0.0, 0.0);
        }
        let found = evaluate_agents(vec![good.clone(), straight.clone()], &Options::default()).unwrap();
        assert_eq!(found.agents[1].merge, None);
        assert!(found.agents[1].evaluation.ate.rmse > 0.1);
        // As the first it is of no use.
        let error = evaluate_agents(vec![straight, good], &Options::default()).unwrap_err().to_string();
        assert!(error.contains("agent 1") && error.contains("one line"), "{error}");
    }

    #[test]
    fn an_estimate_of_another_path_is_refused() {
        let good = agent(0.0, &Sim3::identity(), &Sim3::identity());
        let mut other = good.clone();
        // The same times, and a path that goes to and fro.
        for (i, pose) in other.estimate.world_from_camera.iter_mut().enumerate() {
            let t = i as f64;
            pose.translation = Vector3::new((2.1 * t).sin(), (3.7 * t).cos(), (5.3 * t).sin());
        }
        let error = evaluate_agents(vec![good, other], &Options::default()).unwrap_err().to_string();
        assert!(error.contains("agent 2: it does not follow") && error.contains("--gt A B"), "{error}");
    }

    #[test]
    fn truths_that_are_swapped_are_refused() {
        let agents = |swapped: bool| {
            let mut agents = vec![agent(0.0, &Sim3::identity(), &Sim3::identity()); 2];
            for (estimate, truth) in
                agents.iter_mut().map(|tracks| (&mut tracks.estimate, &mut tracks.truth)).skip(1)
            {
                for (i, pose) in truth.world_from_camera.iter_mut().enumerate() {
                    pose.translation.y = 0.3 * (i as f64 / 7.0).cos();
                }
                estimate.world_from_camera.clone_from(&truth.world_from_camera);
            }
            if swapped {
                let [a, b] = &mut agents[..] else { unreachable!("two were made") };
                std::mem::swap(&mut a.truth, &mut b.truth);
            }
            agents
        };
        assert!(evaluate_agents(agents(false), &Options::default()).is_ok());
        let error = evaluate_agents(agents(true), &Options::default()).unwrap_err().to_string();
        assert!(error.contains("agent 1: it follows the ground truth of agent 2"), "{error}");
    }

    #[test]
    fn the_agent_at_fault_is_named() {
        let good = agent(0.0, &Sim3::identity(), &Sim3::identity());
        let late = AgentTracks { truth: path(100.0), ..good.clone() };
        let error = evaluate_agents(vec![good, late], &Options::default()).unwrap_err().to_string();
        assert!(error.contains("agent 2: no pose"), "{error}");
        assert!(matches!(evaluate_agents(Vec::new(), &Options::default()), Err(EvalError::Setting(_))));
    }
}
