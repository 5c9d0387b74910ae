//! Response and vignette files. The first byte says which of them the rest is.
#![no_main]

use loopbox_fuzz::with_file;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((kind, bytes)) = data.split_first() else { return };
    with_file("photometric", bytes, |path| {
        let (response, vignette) = if kind % 2 == 0 { (Some(path), None) } else { (None, Some(path)) };
        let _ = calib::read_photometric(response, vignette);
    });
});
