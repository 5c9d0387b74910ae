use super::*;
use geometry::{GrayImage, Pyramid, Se3};

/// What a map promises whose first keyframes have so many depths.
fn promised(depths: &[usize]) -> MapQuality {
    let camera = Pinhole { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
    let data = (0..64 * 48).map(|i| ((i * 31) % 251) as u8).collect();
    let image = GrayImage::from_vec(64, 48, data).expect("an image");
    let mut mapper = Mapper::new(camera, Box::new(place_recog::ThumbnailIndex::default()));
    for (keyframe, &count) in depths.iter().enumerate() {
        let pyramid = Pyramid::new(image.clone(), 2);
        mapper.local.push(KeyframeState::new(0.1 * keyframe as f64, 0, pyramid, Se3::identity()));
        let (pixel, depth) = ((0..count as u32).collect(), vec![0.5; count]);
        let depth = SemiDense { pixel, inverse_depth: depth.clone().into(), variance: depth.into() };
        mapper.judge(keyframe, &depth);
    }
    mapper.map_quality()
}

#[test]
fn a_map_none_of_whose_first_keyframes_has_depth_is_wrong() {
    assert_eq!(promised(&[]), MapQuality::Open);
    assert_eq!(promised(&[0, 0]), MapQuality::Open);
    assert_eq!(promised(&[0, 3, 0]), MapQuality::Broken);
    assert_eq!(promised(&[0, 3, 400]), MapQuality::Kept);
    assert_eq!(promised(&[400, 400, 400]), MapQuality::Kept);
}
