//! Marker segments of a JPEG or JPEG-LS stream with one scan of one component (ITU-T T.81 B, T.87 C).

/// Parts of a stream that the decoders use.
#[derive(Debug, Default)]
pub(crate) struct Segments<'a> {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    pub(crate) bits: u32,
    /// Huffman tables of JPEG (DHT), by destination: 16 counts and then the values.
    pub(crate) tables: [Option<&'a [u8]>; 4],
    /// Preset parameters of JPEG-LS (LSE with the type 1): `MAXVAL`, `T1`, `T2`, `T3`, `RESET`.
    pub(crate) preset: Option<[u16; 5]>,
    /// Table of the component, and the three parameters of the scan header (SOS).
    pub(crate) scan: [u8; 4],
    /// Entropy-coded bytes between the scan header and the marker `EOI`.
    pub(crate) data: &'a [u8],
}

/// Divide a stream whose frame header has the given marker; `None` for another kind or an unusual structure.
///
/// The stream must begin with `SOI`, contain one frame header and one scan of one component, no restart interval, and
/// end with `EOI` and at most one byte of padding. `is_marker` says whether the byte after `FF` ends the coded data.
pub(crate) fn segments(
    stream: &[u8],
    frame_marker: u8,
    is_marker: fn(u8) -> bool,
) -> Option<Segments<'_>> {
    let mut found = Segments::default();
    let mut at = 2;
    if stream.get(..2)? != [0xff, 0xd8] {
        return None;
    }
    loop {
        let head = stream.get(at..at + 4)?;
        let length = usize::from(u16::from_be_bytes([head[2], head[3]]));
        let body = stream.get(at + 4..at + 2 + length.max(2))?;
        if head[0] != 0xff {
            return None;
        }
        at += 2 + length.max(2);
        match head[1] {
            marker if marker == frame_marker => {
                // One component without subsampling.
                if found.rows != 0 || body.len() != 9 || body[5] != 1 || body[7] != 0x11 {
                    return None;
                }
                found.bits = u32::from(body[0]);
                found.rows = usize::from(u16::from_be_bytes([body[1], body[2]]));
                found.columns = usize::from(u16::from_be_bytes([body[3], body[4]]));
                found.scan[0] = body[6];
            }
            0xc4 => add_tables(body, &mut found.tables)?,
            0xf8 => found.preset = Some(preset(body)?),
            0xe0..=0xef | 0xfe => {}
            0xda => {
                if found.rows == 0
                    || found.columns == 0
                    || body.len() != 6
                    || body[0] != 1
                    || body[1] != found.scan[0]
                {
                    return None;
                }
                found.scan = [body[2], body[3], body[4], body[5]];
                break;
            }
            _ => return None,
        }
    }
    let rest = stream.get(at..)?;
    let mut end = 0;
    loop {
        end += rest.get(end..)?.iter().position(|byte| *byte == 0xff)?;
        if is_marker(*rest.get(end + 1)?) {
            break;
        }
        end += 2;
    }
    let is_whole = rest[end + 1] == 0xd9 && matches!(rest[end + 2..], [] | [0]);
    found.data = &rest[..end];
    is_whole.then_some(found)
}

fn add_tables<'a>(mut body: &'a [u8], tables: &mut [Option<&'a [u8]>; 4]) -> Option<()> {
    while !body.is_empty() {
        let count = 17
            + body
                .get(1..17)?
                .iter()
                .map(|n| usize::from(*n))
                .sum::<usize>();
        let table = body.get(1..count)?;
        // The class of a table is its upper half: 0 for the tables of lossless JPEG.
        *tables.get_mut(usize::from(body[0]))? = Some(table);
        body = &body[count..];
    }
    Some(())
}

fn preset(body: &[u8]) -> Option<[u16; 5]> {
    if body.len() != 11 || body[0] != 1 {
        return None;
    }
    Some(std::array::from_fn(|n| {
        u16::from_be_bytes([body[1 + 2 * n], body[2 + 2 * n]])
    }))
}
