//! All parameters of the agent, gathered.

use crate::align::AlignParams;
use crate::atlas::params::AtlasParams;
use crate::bootstrap::params::BootstrapParams;
use crate::closing::params::ClosingParams;
use crate::depth::DepthParams;
use crate::keyframes::KeyframeParams;
use crate::mapping::MappingParams;
use crate::patch;
use crate::relocalise::RelocaliseParams;
use crate::track::TrackParams;
use crate::triangulate::TriangulateParams;
use crate::wide::WideParams;
use backend::{ParameterError, check_parameters, params};
use geometry::Pinhole;

params! {
    /// Parameters of the direct SLAM agent.
    pub struct Params {
        /// Making the first map.
        pub bootstrap: BootstrapParams = BootstrapParams::default(),
        /// Direct alignment of a frame.
        pub align: AlignParams = AlignParams::default(),
        /// Map-to-frame tracking.
        pub track: TrackParams = TrackParams::default(),
        /// When a frame becomes a keyframe, when tracking is lost.
        pub keyframes: KeyframeParams = KeyframeParams::default(),
        /// Points and window optimisation.
        pub mapping: MappingParams = MappingParams::default(),
        /// The wide search for a frame before it counts as lost.
        pub wide: WideParams = WideParams::default(),
        /// Finding a lost frame again.
        pub relocalise: RelocaliseParams = RelocaliseParams::default(),
        /// After a loss.
        pub atlas: AtlasParams = AtlasParams::default(),
        /// Closing loops.
        pub closing: ClosingParams = ClosingParams::default(),
        /// Semi-dense depth.
        pub depth: DepthParams = DepthParams::default(),
        /// Depth of new points.
        pub triangulate: TriangulateParams = TriangulateParams::default(),
    }
}

impl Params {
    /// The same parameters with this `mapping.lag`: the number of frames that mapping takes in the background.
    pub fn with_lag(mut self, lag: usize) -> Self {
        self.mapping.lag = lag;
        self
    }

    /// The same for images of a camera: what is spread over an image in blocks and cells is spread as densely over a small
    /// one. A map needs some hundred points, however few pixels it is made of.
    pub(crate) fn for_images_of(mut self, camera: &Pinhole) -> Self {
        /// Pixels of an image from which on blocks and cells are those of the parameters.
        const USUAL: f64 = 200_000.0;
        let factor = ((camera.width * camera.height) as f64 / USUAL).sqrt().min(1.0);
        // Patches of neighbouring blocks may overlap by half.
        let least = patch::SIZE / 2 + 2;
        let scaled = |pixels: usize| ((pixels as f64 * factor).round() as usize).max(least.min(pixels));
        self.bootstrap.block = scaled(self.bootstrap.block);
        self.mapping.block = scaled(self.mapping.block);
        self.track.cell = scaled(self.track.cell);
        self
    }

    /// Refuses unusable values: out of the range that the parameter's documentation states, not finite, negative, or
    /// a count of zero.
    ///
    /// # Errors
    /// Names the first such parameter.
    pub fn validate(&self) -> Result<(), ParameterError> {
        check_parameters(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use backend::{DocumentedParameter, Parameter, ParameterValue};

    #[test]
    fn small_images_are_divided_as_finely_as_large_ones() {
        let camera = |width: usize, height: usize| {
            let f = width as f64;
            Pinhole { width, height, fx: f, fy: f, cx: 0.5 * f, cy: 0.5 * height as f64 }
        };
        let params = Params::default();
        let blocks = |width: usize, height: usize| {
            let side = params.clone().for_images_of(&camera(width, height)).mapping.block;
            (width / side) * (height / side)
        };
        assert_eq!(params.clone().for_images_of(&camera(640, 480)), params);
        assert!(
            blocks(320, 240) > 400 && blocks(160, 120) > 200,
            "{} {}",
            blocks(320, 240),
            blocks(160, 120)
        );
    }

    /// The numbers among these parameters whose documentation states no range that holds their default.
    fn without_range(path: &str, fields: &[DocumentedParameter]) -> Vec<String> {
        let of = |field: &DocumentedParameter| match &field.default {
            ParameterValue::Table(inner) => without_range(&format!("{path}{}.", field.name), inner),
            ParameterValue::Plain(text) => {
                let states = |number: f64| {
                    let (least, most) = backend::stated_range(&field.doc.concat())?;
                    (least..=most).contains(&number).then_some(())
                };
                let is_bare = text.parse().is_ok_and(|number| states(number).is_none());
                if is_bare { vec![format!("{path}{} = {text}", field.name)] } else { Vec::new() }
            }
        };
        fields.iter().flat_map(of).collect()
    }

    #[test]
    fn every_number_has_a_range() {
        assert_eq!(without_range("", &Params::documented()), Vec::<String>::new());
    }

    #[test]
    fn values_that_would_divide_by_zero_are_refused() {
        assert_eq!(Params::default().validate(), Ok(()));
        let refused = |change: fn(&mut Params)| {
            let mut params = Params::default();
            change(&mut params);
            params.validate().expect_err("it cannot be worked with").name
        };
        assert_eq!(refused(|p| p.track.cell = 0), "track.cell");
        assert_eq!(refused(|p| p.mapping.block = 0), "mapping.block");
        assert_eq!(refused(|p| p.mapping.window = 0), "mapping.window");
        assert_eq!(refused(|p| p.align.pyramid_levels = 0), "align.pyramid_levels");
        assert_eq!(refused(|p| p.closing.max_drift = f64::NAN), "closing.max_drift");
    }
}
