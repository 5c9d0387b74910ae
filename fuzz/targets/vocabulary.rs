//! Vocabularies; what is read is written as it was.
#![no_main]

use place_recog::Vocabulary;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Ok(vocabulary) = Vocabulary::from_bytes(data) {
        let written = vocabulary.to_bytes();
        assert!(Vocabulary::from_bytes(&written).is_ok(), "what was written is read");
    }
});
