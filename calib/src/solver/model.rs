//! The camera models that can be calibrated, as functions of one vector of parameters.

use geometry::{Camera, CameraError, Distortion, Fov, KannalaBrandt, Pinhole, RadTan};
use nalgebra::{Matrix2x3, SMatrix, SVector, Vector2, Vector3};
use std::fmt;
use std::str::FromStr;

/// Most parameters of a model: `fx fy cx cy` and five terms.
pub(crate) const MAX_PARAMETERS: usize = 9;
/// `fx fy cx cy`, then the terms; zero beyond the model's count.
pub(crate) type Parameters = SVector<f64, MAX_PARAMETERS>;
/// Derivative of a pixel by the parameters.
pub(crate) type ByParameters = SMatrix<f64, 2, MAX_PARAMETERS>;

/// A camera model to calibrate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LensModel {
    /// No distortion.
    Pinhole,
    /// Radial and tangential, `k1 k2 p1 p2`.
    RadTan4,
    /// Radial and tangential, `k1 k2 p1 p2 k3`.
    RadTan5,
    /// Kannala–Brandt fisheye, `k1 k2 k3 k4`.
    Kb4,
    /// Field of view, `ω`.
    Fov,
}

impl LensModel {
    /// Names of the parameters, in their order.
    pub fn parameter_names(self) -> &'static [&'static str] {
        match self {
            Self::Pinhole => &["fx", "fy", "cx", "cy"],
            Self::RadTan4 => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"],
            Self::RadTan5 => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"],
            Self::Kb4 => &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"],
            Self::Fov => &["fx", "fy", "cx", "cy", "omega"],
        }
    }

    /// Number of parameters.
    pub fn parameter_count(self) -> usize {
        self.parameter_names().len()
    }

    /// The model by which corners that were found wrongly are told: as flexible as there is one, so that a lens that the
    /// model does not quite fit is not taken for wrong corners.
    pub(crate) fn judge(self) -> Self {
        match self {
            Self::Pinhole | Self::RadTan4 | Self::RadTan5 => Self::RadTan5,
            Self::Kb4 | Self::Fov => Self::Kb4,
        }
    }

    /// The camera of these parameters.
    ///
    /// # Errors
    /// When they describe none.
    pub(crate) fn camera(self, size: (usize, usize), parameters: &Parameters) -> Result<Camera, CameraError> {
        let p = parameters.as_slice();
        let terms = &p[4..self.parameter_count()];
        let distortion = match self {
            Self::Pinhole => Distortion::None,
            Self::RadTan4 | Self::RadTan5 => Distortion::RadTan(RadTan::new(terms)?),
            Self::Kb4 => Distortion::KannalaBrandt(KannalaBrandt::new(terms)?),
            Self::Fov => Distortion::Fov(Fov::new(terms)?),
        };
        let (width, height) = size;
        Camera::new(Pinhole { width, height, fx: p[0], fy: p[1], cx: p[2], cy: p[3] }, distortion)
    }

    /// The model of a camera; `None` when it has terms that no model here has.
    pub(crate) fn of(camera: &Camera) -> Option<Self> {
        match camera.distortion() {
            Distortion::None => Some(Self::Pinhole),
            Distortion::RadTan(lens) => (lens.terms().len() <= 5).then_some(Self::RadTan5),
            Distortion::KannalaBrandt(_) => Some(Self::Kb4),
            Distortion::Fov(_) => Some(Self::Fov),
        }
    }

    /// The parameters of a camera of this model.
    pub(crate) fn parameters(self, camera: &Camera) -> Parameters {
        let Pinhole { fx, fy, cx, cy, .. } = *camera.intrinsics();
        let terms = match camera.distortion() {
            Distortion::None => Vec::new(),
            Distortion::RadTan(lens) => lens.terms(),
            Distortion::KannalaBrandt(lens) => lens.terms().to_vec(),
            Distortion::Fov(lens) => vec![lens.omega()],
        };
        let all = [fx, fy, cx, cy].into_iter().chain(terms);
        Parameters::from_iterator(all.chain(std::iter::repeat(0.0)).take(MAX_PARAMETERS))
    }

    /// Pixel of a point of the camera frame, with its derivatives by the point and by the parameters; `None` where
    /// the model has no meaning.
    pub(crate) fn project(
        self,
        camera: &Camera,
        point: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>, ByParameters)> {
        let (pixel, by_point) = camera.project_with_jacobian(point)?;
        let Pinhole { fx, fy, cx, cy, .. } = *camera.intrinsics();
        let mut by = ByParameters::zeros();
        by[(0, 0)] = (pixel.x - cx) / fx;
        by[(1, 1)] = (pixel.y - cy) / fy;
        by[(0, 2)] = 1.0;
        by[(1, 3)] = 1.0;
        for (i, bent) in self.bent_by_terms(camera, point).into_iter().enumerate() {
            by[(0, 4 + i)] = fx * bent.x;
            by[(1, 4 + i)] = fy * bent.y;
        }
        Some((pixel, by_point, by))
    }

    /// Derivative of the bent plane coordinates by each term.
    fn bent_by_terms(self, camera: &Camera, point: &Vector3<f64>) -> [Vector2<f64>; 5] {
        let zero = Vector2::zeros();
        let plane = point.xy() / point.z;
        let (x, y, u) = (plane.x, plane.y, plane.norm_squared());
        let tangential =
            [Vector2::new(2.0 * x * y, u + 2.0 * y * y), Vector2::new(u + 2.0 * x * x, 2.0 * x * y)];
        match self {
            Self::Pinhole => [zero; 5],
            Self::RadTan4 => [plane * u, plane * (u * u), tangential[0], tangential[1], zero],
            Self::RadTan5 => [plane * u, plane * (u * u), tangential[0], tangential[1], plane * (u * u * u)],
            Self::Kb4 => {
                let r = point.xy().norm();
                let theta = r.atan2(point.z);
                let direction = if r > 0.0 { point.xy() / r } else { zero };
                let power = |exponent: i32| direction * theta.powi(exponent);
                [power(3), power(5), power(7), power(9), zero]
            }
            Self::Fov => [plane * fov_ratio_by_omega(camera, u.sqrt()), zero, zero, zero, zero],
        }
    }
}

/// Derivative of `atan(2 r tan(ω/2)) / (ω r)` by ω.
fn fov_ratio_by_omega(camera: &Camera, r: f64) -> f64 {
    let Distortion::Fov(lens) = camera.distortion() else { return 0.0 };
    let omega = lens.omega();
    let tan = (0.5 * omega).tan();
    let ar = 2.0 * tan * r;
    // atan(a r) / r goes to a at the axis.
    let angle_by_r = if r > 1e-9 { ar.atan() / r } else { 2.0 * tan };
    (1.0 + tan * tan) / (1.0 + ar * ar) / omega - angle_by_r / (omega * omega)
}

impl FromStr for LensModel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "pinhole" => Ok(Self::Pinhole),
            "radtan" | "pinhole-radtan" | "radtan4" => Ok(Self::RadTan4),
            "radtan5" => Ok(Self::RadTan5),
            "kb4" => Ok(Self::Kb4),
            "fov" => Ok(Self::Fov),
            _ => Err(format!("\"{text}\" is no camera model; give pinhole, radtan, radtan5, kb4 or fov")),
        }
    }
}

/// As it is given on the command line.
impl fmt::Display for LensModel {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Pinhole => "pinhole",
            Self::RadTan4 => "radtan",
            Self::RadTan5 => "radtan5",
            Self::Kb4 => "kb4",
            Self::Fov => "fov",
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) const SIZE: (usize, usize) = (752, 480);

    /// A camera of each model with terms of real lenses.
    pub(crate) fn cameras() -> [(LensModel, Camera); 5] {
        let of = |model: LensModel, terms: &[f64]| {
            let all = [458.0, 457.0, 367.0, 248.0].iter().chain(terms).copied();
            let p = Parameters::from_iterator(all.chain([0.0; 5]).take(MAX_PARAMETERS));
            (model, model.camera(SIZE, &p).unwrap())
        };
        [
            of(LensModel::Pinhole, &[]),
            of(LensModel::RadTan4, &[-0.28, 0.074, 0.0002, 0.00002]),
            of(LensModel::RadTan5, &[-0.28, 0.09, 0.001, -0.002, -0.01]),
            of(LensModel::Kb4, &[-0.01, 0.03, -0.02, 0.005]),
            of(LensModel::Fov, &[0.93]),
        ]
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        for (model, camera) in cameras() {
            let parameters = model.parameters(&camera);
            for point in [[0.0, 0.0, 1.0], [0.3, -0.2, 1.1], [-0.5, 0.35, 0.9], [1e-7, 0.0, 1.0]] {
                let point = Vector3::from(point);
                let (_, by_point, by_parameters) = model.project(&camera, &point).unwrap();
                for i in 0..3 {
                    let step = Vector3::ith(i, 1e-6);
                    let d = (camera.project(&(point + step)).unwrap()
                        - camera.project(&(point - step)).unwrap())
                        / 2e-6;
                    assert!((d - by_point.column(i)).norm() < 1e-4, "{model} {point:?} by point {i}");
                }
                for i in 0..model.parameter_count() {
                    let h = 1e-6 * parameters[i].abs().max(1.0);
                    let at = |h: f64| {
                        let mut moved = parameters;
                        moved[i] += h;
                        model.camera(SIZE, &moved).unwrap().project(&point).unwrap()
                    };
                    let d = (at(h) - at(-h)) / (2.0 * h);
                    let name = model.parameter_names()[i];
                    assert!((d - by_parameters.column(i)).norm() < 1e-4, "{model} {point:?} by {name}");
                }
            }
        }
    }

    #[test]
    fn names_lead_to_models_and_back() {
        for (model, camera) in cameras() {
            assert_eq!(model.to_string().parse(), Ok(model));
            assert_eq!(model.camera(SIZE, &model.parameters(&camera)).unwrap(), camera);
        }
        assert_eq!("pinhole-radtan".parse(), Ok(LensModel::RadTan4));
        assert!("fisheye".parse::<LensModel>().unwrap_err().contains("kb4"));
    }
}
