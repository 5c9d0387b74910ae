//! Robust kernels on the squared Mahalanobis error of an edge.

use crate::{Parameter, ParameterValue, params};
use serde::{Deserialize, Serialize};

/// The shape of a robust kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KernelShape {
    /// Least squares: every edge counts fully.
    Quadratic,
    /// Linear beyond the width; convex, an outlier keeps a bounded pull.
    Huber,
    /// Logarithmic; the pull of an outlier fades.
    Cauchy,
    /// Saturates; an outlier loses all pull. Equals switchable constraints with the switches
    /// eliminated (dynamic covariance scaling, Agarwal 2013, up to a factor).
    GemanMcClure,
}

impl Parameter for KernelShape {
    fn value(&self) -> ParameterValue {
        let name = match self {
            Self::Quadratic => "quadratic",
            Self::Huber => "huber",
            Self::Cauchy => "cauchy",
            Self::GemanMcClure => "geman-mc-clure",
        };
        ParameterValue::Plain(format!("\"{name}\""))
    }
}

params! {
    /// A robust kernel: a shape and the error at which it begins to bend.
    pub struct RobustKernel {
        /// The shape: quadratic, huber, cauchy or geman-mc-clure.
        pub shape: KernelShape = KernelShape::Huber,
        /// Error at which the kernel bends, in standard deviations, > 0. Range 0.1–100.
        pub width: f64 = 3.0,
    }
}

impl Copy for RobustKernel {}

impl RobustKernel {
    /// The error up to which the cost is convex, standard deviations: where an edge that lies within cannot
    /// make a local minimum. Infinite for the shapes that are convex throughout.
    pub(super) fn convex_within(self) -> f64 {
        match self.shape {
            KernelShape::Quadratic | KernelShape::Huber => f64::INFINITY,
            KernelShape::Cauchy => self.width,
            KernelShape::GemanMcClure => self.width / 3f64.sqrt(),
        }
    }

    /// The same kernel, `widening` times as wide.
    ///
    /// All kernels widen together: were the Huber ones of the odometry not, a widened false loop
    /// would win against their linear cost and be kept while it narrows.
    pub(super) fn widened(self, widening: f64) -> Self {
        Self { width: self.width * widening, ..self }
    }

    /// Cost of a squared error; equals it for small errors.
    pub fn cost(self, squared_error: f64) -> f64 {
        let k2 = self.width * self.width;
        match self.shape {
            KernelShape::Quadratic => squared_error,
            KernelShape::Huber if squared_error <= k2 => squared_error,
            KernelShape::Huber => 2.0 * self.width * squared_error.sqrt() - k2,
            KernelShape::Cauchy => k2 * (squared_error / k2).ln_1p(),
            KernelShape::GemanMcClure => k2 * squared_error / (k2 + squared_error),
        }
    }

    /// Derivative of [`Self::cost`], 0–1: the weight of the edge in the reweighted least squares.
    pub fn weight(self, squared_error: f64) -> f64 {
        let k2 = self.width * self.width;
        match self.shape {
            KernelShape::Quadratic => 1.0,
            KernelShape::Huber if squared_error <= k2 => 1.0,
            KernelShape::Huber => self.width / squared_error.sqrt(),
            KernelShape::Cauchy => k2 / (k2 + squared_error),
            KernelShape::GemanMcClure => (k2 / (k2 + squared_error)).powi(2),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_documented_by_the_names_they_are_read_by() {
        for shape in
            [KernelShape::Quadratic, KernelShape::Huber, KernelShape::Cauchy, KernelShape::GemanMcClure]
        {
            let ParameterValue::Plain(text) = shape.value() else { panic!("a shape is a plain value") };
            let name = text.trim_matches('"');
            let read: KernelShape = KernelShape::deserialize(serde::de::value::StrDeserializer::<
                serde::de::value::Error,
            >::new(name))
            .unwrap();
            assert_eq!(read, shape);
        }
    }

    #[test]
    fn costs_bend_over_where_they_cease_to_be_convex() {
        for shape in [KernelShape::Cauchy, KernelShape::GemanMcClure] {
            let kernel = RobustKernel { shape, width: 2.0 };
            let cost = |error: f64| kernel.cost(error * error);
            let curvature = |e: f64| cost(e + 1e-3) + cost(e - 1e-3) - 2.0 * cost(e);
            let end = kernel.convex_within();
            assert!(curvature(0.99 * end) > 0.0 && curvature(1.01 * end) < 0.0, "{shape:?}");
        }
    }

    #[test]
    fn weights_are_the_derivatives_of_the_costs() {
        for shape in
            [KernelShape::Quadratic, KernelShape::Huber, KernelShape::Cauchy, KernelShape::GemanMcClure]
        {
            let kernel = RobustKernel { shape, width: 1.7 };
            for squared_error in [0.01, 1.0, 2.8, 3.0, 40.0, 1e4] {
                let h = 1e-5 * squared_error;
                let slope = (kernel.cost(squared_error + h) - kernel.cost(squared_error - h)) / (2.0 * h);
                assert!((slope - kernel.weight(squared_error)).abs() < 1e-6, "{shape:?} at {squared_error}");
            }
        }
    }
}
