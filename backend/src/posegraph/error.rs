//! What the pose graph refuses.

use super::PoseGraphParams;
use crate::SystemError;
use geometry::Sim3;
use map::{Edge, KeyframeId};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;
use thiserror::Error;

/// Why a pose graph was not optimised.
#[derive(Clone, Debug, PartialEq, Error, Serialize, Deserialize)]
pub enum PoseGraphError {
    /// A node's pose has a NaN, an infinity or a scale that is not positive.
    #[error(
        "the pose of keyframe {0:?} is not a finite similarity; drop the keyframe or re-estimate its pose"
    )]
    InvalidNode(KeyframeId),
    /// An edge's measured similarity is unusable.
    #[error("edge {index} ({from:?} to {to:?}) measures no finite similarity; drop it")]
    InvalidMeasurement {
        /// Index in the given edges.
        index: usize,
        /// Its `from`.
        from: KeyframeId,
        /// Its `to`.
        to: KeyframeId,
    },
    /// An edge's information is not finite, not symmetric or has a negative diagonal.
    #[error(
        "the information of edge {index} ({from:?} to {to:?}) is no covariance inverse: {what}; drop the edge"
    )]
    InvalidInformation {
        /// Index in the given edges.
        index: usize,
        /// Its `from`.
        from: KeyframeId,
        /// Its `to`.
        to: KeyframeId,
        /// What is wrong.
        what: Cow<'static, str>,
    },
    /// An edge names a keyframe that is not among the nodes.
    #[error("edge {index} names keyframe {missing:?}, which is not a node; add the node or drop the edge")]
    UnknownKeyframe {
        /// Index in the given edges.
        index: usize,
        /// The absent keyframe.
        missing: KeyframeId,
    },
    /// An edge joins a keyframe with itself.
    #[error("edge {index} joins keyframe {keyframe:?} with itself; drop it")]
    SelfEdge {
        /// Index in the given edges.
        index: usize,
        /// The keyframe.
        keyframe: KeyframeId,
    },
    /// A kernel width is not positive.
    #[error("a kernel width of the pose graph is not a positive number; set it above zero")]
    InvalidKernelWidth,
    /// The linear solver could not be set up.
    #[error(transparent)]
    Solver(#[from] SystemError),
}

/// Refuses input that would poison the whole graph.
pub(super) fn check(
    nodes: &BTreeMap<KeyframeId, Sim3>,
    edges: &[Edge],
    params: &PoseGraphParams,
) -> Result<(), PoseGraphError> {
    let kernels = [params.odometry, params.covisibility, params.loop_closure, params.merge];
    if kernels.iter().any(|kernel| !(kernel.width > 0.0 && kernel.width.is_finite())) {
        return Err(PoseGraphError::InvalidKernelWidth);
    }
    check_nodes(nodes)?;
    edges.iter().enumerate().try_for_each(|(index, edge)| check_edge(nodes, index, edge))
}

/// Refuses poses that are no similarities.
pub(super) fn check_nodes(nodes: &BTreeMap<KeyframeId, Sim3>) -> Result<(), PoseGraphError> {
    match nodes.iter().find(|(_, pose)| !pose.is_valid()) {
        Some((&id, _)) => Err(PoseGraphError::InvalidNode(id)),
        None => Ok(()),
    }
}

fn check_edge(nodes: &BTreeMap<KeyframeId, Sim3>, index: usize, edge: &Edge) -> Result<(), PoseGraphError> {
    let (from, to) = (edge.from, edge.to);
    if from == to {
        return Err(PoseGraphError::SelfEdge { index, keyframe: from });
    }
    if let Some(missing) = [from, to].into_iter().find(|id| !nodes.contains_key(id)) {
        return Err(PoseGraphError::UnknownKeyframe { index, missing });
    }
    check_measurement(index, edge)
}

/// Refuses what an edge measures when it is no similarity or its information none.
pub(super) fn check_measurement(index: usize, edge: &Edge) -> Result<(), PoseGraphError> {
    let (from, to) = (edge.from, edge.to);
    if !edge.from_from_to.is_valid() {
        return Err(PoseGraphError::InvalidMeasurement { index, from, to });
    }
    let information = &edge.information;
    let what = if information.iter().any(|v| !v.is_finite()) {
        "it holds a number that is not finite"
    } else if information.diagonal().min() < 0.0 {
        "its diagonal is negative"
    } else if (information - information.transpose()).amax() > 1e-6 * information.amax() {
        "it is not symmetric"
    } else {
        return Ok(());
    };
    Err(PoseGraphError::InvalidInformation { index, from, to, what: what.into() })
}
