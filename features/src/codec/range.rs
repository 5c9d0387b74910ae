//! Range coding (Martin 1979): symbols become bytes, each in as many bits as it is improbable.

/// The range is kept above this by writing a byte.
const BOTTOM: u32 = 1 << 24;

/// What part of the range a symbol takes: `[start, start + size)` of `total`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Where it begins.
    pub start: u32,
    /// How large it is; above 0.
    pub size: u32,
    /// Size of the whole; at most 2¹⁶.
    pub total: u32,
}

impl Part {
    /// The part of a value that is one of `total` equally probable ones.
    pub fn uniform(value: u32, total: u32) -> Self {
        Self { start: value, size: 1, total }
    }
}

/// Writes symbols.
pub struct Encoder {
    low: u64,
    range: u32,
    bytes: Vec<u8>,
}

impl Encoder {
    /// One that appends to `bytes`.
    pub fn new(bytes: Vec<u8>) -> Self {
        Self { low: 0, range: u32::MAX, bytes }
    }

    /// Writes a symbol.
    pub fn put(&mut self, part: Part) {
        let unit = self.range / part.total;
        self.low += u64::from(unit) * u64::from(part.start);
        self.range = unit * part.size;
        if self.low > u64::from(u32::MAX) {
            // Carried into the bytes that are written; it ends there, as what they stand for is below one.
            self.low &= u64::from(u32::MAX);
            for byte in self.bytes.iter_mut().rev() {
                *byte = byte.wrapping_add(1);
                if *byte != 0 {
                    break;
                }
            }
        }
        while self.range < BOTTOM {
            self.shift();
            self.range <<= 8;
        }
    }

    /// All bytes.
    pub fn finish(mut self) -> Vec<u8> {
        for _ in 0..4 {
            self.shift();
        }
        self.bytes
    }

    fn shift(&mut self) {
        self.bytes.push((self.low >> 24) as u8);
        self.low = self.low << 8 & u64::from(u32::MAX);
    }
}

/// Reads symbols; of any bytes some, without a panic.
pub struct Decoder<'a> {
    /// How far the code lies above the lower end of the range.
    code: u32,
    range: u32,
    bytes: &'a [u8],
    read: usize,
}

impl<'a> Decoder<'a> {
    /// One that reads all of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self { code: 0, range: u32::MAX, bytes, read: 0 };
        for _ in 0..4 {
            decoder.shift();
        }
        decoder
    }

    /// Reads a symbol: `part_of` gives the part that holds a place below `total`, and what it means.
    pub fn take<T>(&mut self, total: u32, part_of: impl FnOnce(u32) -> (Part, T)) -> T {
        let unit = self.range / total;
        let (part, symbol) = part_of((self.code / unit).min(total - 1));
        self.code -= unit * part.start;
        self.range = unit * part.size;
        while self.range < BOTTOM {
            self.shift();
            self.range <<= 8;
        }
        symbol
    }

    /// Reads one of `total` equally probable values.
    pub fn uniform(&mut self, total: u32) -> u32 {
        self.take(total, |place| (Part::uniform(place, total), place))
    }

    /// Bytes that were missing so far.
    pub fn missing(&self) -> usize {
        self.read.saturating_sub(self.bytes.len())
    }

    /// Bytes that were not needed so far.
    pub fn left(&self) -> usize {
        self.bytes.len().saturating_sub(self.read)
    }

    fn shift(&mut self) {
        let byte = self.bytes.get(self.read).copied().unwrap_or(0);
        self.code = self.code << 8 | u32::from(byte);
        self.read += 1;
    }
}

/// How often symbols occurred so far, and so how probable they are: for what is not known beforehand.
pub struct Adaptive {
    counts: Vec<u32>,
    total: u32,
}

impl Adaptive {
    /// What a symbol adds to its count.
    const STEP: u32 = 24;

    /// Of so many symbols, each equally probable at first.
    pub fn new(symbols: usize) -> Self {
        Self { counts: vec![1; symbols], total: symbols as u32 }
    }

    /// Writes a symbol.
    pub fn put(&mut self, symbol: usize, encoder: &mut Encoder) {
        let start = self.counts[..symbol].iter().sum();
        encoder.put(Part { start, size: self.counts[symbol], total: self.total });
        self.learn(symbol);
    }

    /// Reads a symbol.
    pub fn take(&mut self, decoder: &mut Decoder) -> usize {
        let (total, counts) = (self.total, &self.counts);
        let symbol = decoder.take(total, |place| {
            let (mut symbol, mut start) = (0, 0);
            while start + counts[symbol] <= place {
                start += counts[symbol];
                symbol += 1;
            }
            (Part { start, size: counts[symbol], total }, symbol)
        });
        self.learn(symbol);
        symbol
    }

    fn learn(&mut self, symbol: usize) {
        self.counts[symbol] += Self::STEP;
        self.total += Self::STEP;
        if self.total > 1 << 14 {
            // Forgets the half.
            self.counts.iter_mut().for_each(|count| *count = count.div_ceil(2));
            self.total = self.counts.iter().sum();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_written_is_read(symbols in prop::collection::vec((0u32..1000, 1u32..65537, 0usize..20), 0..500)) {
            let mut encoder = Encoder::new(Vec::new());
            let mut adaptive = Adaptive::new(20);
            for &(value, total, symbol) in &symbols {
                encoder.put(Part::uniform(value % total, total));
                adaptive.put(symbol, &mut encoder);
            }
            let bytes = encoder.finish();
            let mut decoder = Decoder::new(&bytes);
            let mut adaptive = Adaptive::new(20);
            for (value, total, symbol) in symbols {
                prop_assert_eq!(decoder.uniform(total), value % total);
                prop_assert_eq!(adaptive.take(&mut decoder), symbol);
            }
            prop_assert_eq!((decoder.missing(), decoder.left()), (0, 0));
        }
    }

    #[test]
    fn a_carry_runs_through_full_bytes() {
        let mut encoder = Encoder::new(Vec::new());
        let parts = [Part { start: 65535, size: 1, total: 65536 }; 40];
        parts.iter().for_each(|&part| encoder.put(part));
        encoder.put(Part { start: 1, size: 65535, total: 65536 });
        let bytes = encoder.finish();
        let mut decoder = Decoder::new(&bytes);
        assert!(parts.iter().all(|_| decoder.uniform(65536) == 65535));
    }
}
