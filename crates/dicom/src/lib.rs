//! Fast reading of ordinary DICOM slices: header elements, uncompressed, RLE, JPEG-LS and lossless JPEG pixels, and checks.
//!
//! Every function accepts only input that it fully understands and returns `None` for the rest: damaged, unusual or
//! doubtful files. The Python package reads these by pydicom and GDCM, which are slower and decide about errors and
//! notes. Tests compare both ways on the whole corpus of inputs.

mod excess;
mod header;
mod jpeg_ls;
mod jpeg_stream;
mod lossless_jpeg;
mod pixels;
mod rle;

pub use excess::excesses;
pub use header::{HeaderElements, Wanted, scan_file};
pub use jpeg_ls::decode_jpeg_ls;
pub use jpeg_stream::DecodedStream;
pub use lossless_jpeg::{TruncatedHeader, decode_lossless_jpeg, lossless_jpeg_problem};
pub use pixels::{Coding, SliceFormat, SliceSource, decode_slices, place_words};
pub use rle::decode_rle;
