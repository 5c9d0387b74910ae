//! Messages with images and calibrations, which in a recording lie behind checksums. The first byte says which form.
#![no_main]

use sources::messages::{Form, read_calibration, read_image};

const FORMS: [Form; 10] = [
    Form::FoxgloveCompressed,
    Form::FoxgloveRaw,
    Form::FoxgloveCalibration,
    Form::FoxgloveJson,
    Form::Ros2Compressed,
    Form::Ros2Raw,
    Form::Ros2CameraInfo,
    Form::Ros1Compressed,
    Form::Ros1Raw,
    Form::Ros1CameraInfo,
];

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((form, message)) = data.split_first() else { return };
    let form = FORMS[*form as usize % FORMS.len()];
    if let Ok(image) = read_image(form, message) {
        let _ = image.picture.into_grey();
    }
    let _ = read_calibration(form, message);
});
