//! Parts that all JPEG streams share: the decoded values, and the data before a marker.

/// Values of a decoded stream, row by row, and the number of bits that the stream states for each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DecodedStream {
    /// Decoded values.
    pub words: Vec<u16>,
    /// Bits of a value.
    pub bits: u32,
}

/// Return the data before the first marker whose second byte is an end; all data without such a marker.
pub(crate) fn data_before(data: &[u8], is_end: impl Fn(u8) -> bool) -> &[u8] {
    let marker = data
        .windows(2)
        .position(|two| two[0] == 0xff && is_end(two[1]));
    &data[..marker.unwrap_or(data.len())]
}
