//! Layers of scan vectors: what goes in comes out, in any split; the bytes are the documented ones; bad bytes end in an error.

mod any_layer;
mod golden;
mod large;
#[path = "../../../tests/properties/mod.rs"]
mod properties;
mod refused;

use layerd_wire::encoding::{
    HatchFrame, HatchLine, LaserParameters, LayerSum, MarkClass, Vector, VectorDecoder, VectorEncodeError,
    VectorEncoder, VectorEncoding, VectorError,
};

const BOTH: [VectorEncoding; 2] = [VectorEncoding::Plain, VectorEncoding::Coded];
const FIELD_UM: [u32; 2] = [100_000, 80_000];

/// A run of vectors.
#[derive(Clone, Debug)]
enum Run {
    Path(MarkClass, Vec<[i32; 2]>),
    Hatches(MarkClass, HatchFrame, Vec<HatchLine>),
}

fn laser(number: u32) -> LaserParameters {
    LaserParameters {
        power_mw: 100_000 + number,
        mark_speed_um_s: 800_000,
        jump_speed_um_s: 5_000_000,
        focus_um: -20 * number as i32,
        jump_delay_us: 100,
        mark_delay_us: 50,
        polygon_delay_us: 20,
        point_time_us: 400,
    }
}

fn table() -> Vec<(MarkClass, LaserParameters)> {
    MarkClass::ALL.into_iter().map(|class| (class, laser(class as u32))).collect()
}

fn write(encoder: &mut VectorEncoder<'_>, runs: &[Run]) -> Result<(), VectorEncodeError> {
    runs.iter().try_for_each(|run| match run {
        Run::Path(class, points) => encoder.path(*class, points),
        Run::Hatches(class, frame, lines) => encoder.hatches(*class, frame, lines.iter().copied()),
    })
}

fn encoded(encoding: VectorEncoding, runs: &[Run]) -> Result<(Vec<u8>, LayerSum), VectorEncodeError> {
    let mut bytes = vec![7; 3];
    let mut encoder = VectorEncoder::new(encoding, FIELD_UM, &table(), &mut bytes)?;
    write(&mut encoder, runs)?;
    let sum = encoder.finish();
    Ok((bytes, sum))
}

fn decoded(
    encoding: VectorEncoding,
    bytes: &[u8],
    announced: usize,
    piece: usize,
) -> Result<(Vec<Vector>, LayerSum), VectorError> {
    let mut decoder = VectorDecoder::new(encoding, FIELD_UM, announced as u32);
    let mut vectors = Vec::new();
    for mut piece in bytes.chunks(piece) {
        while let Some(vector) = decoder.next(&mut piece)? {
            vectors.push(vector);
        }
        assert!(piece.is_empty(), "all bytes are taken");
    }
    // A layer that ends with its announced bytes has no more vectors, and no other answer.
    assert_eq!(decoder.next(&mut &[][..]), Ok(None));
    for (class, laser) in table() {
        assert_eq!(decoder.parameters(class), Some(&laser));
    }
    decoder.finish().map(|sum| (vectors, sum))
}

/// What a device learns of bytes in the end.
fn finished(encoding: VectorEncoding, mut bytes: &[u8], announced: usize) -> Result<LayerSum, VectorError> {
    let mut decoder = VectorDecoder::new(encoding, FIELD_UM, announced as u32);
    while decoder.next(&mut bytes)?.is_some() {}
    decoder.finish()
}

/// The vectors of runs, by plain means.
fn expected(runs: &[Run]) -> Vec<Vector> {
    let mut vectors = Vec::new();
    for run in runs {
        let (class, ends): (_, Vec<_>) = match run {
            Run::Path(class, points) if points.len() == 1 => (*class, vec![[points[0]; 2]]),
            Run::Path(class, points) => (*class, points.windows(2).map(|pair| [pair[0], pair[1]]).collect()),
            Run::Hatches(class, frame, lines) => {
                let ends = |hatch: &HatchLine| [hatch.from_um, hatch.to_um].map(|at| point_um(frame, hatch.line, at));
                (*class, lines.iter().map(ends).collect())
            }
        };
        for [from_um, to_um] in ends {
            vectors.push(Vector { number: vectors.len() as u32, class, from_um, to_um });
        }
    }
    vectors
}

/// A point of a frame, with numbers of 128 bits.
fn point_um(frame: &HatchFrame, line: i32, along_um: i32) -> [i32; 2] {
    let [ux, uy] = frame.along.map(i128::from);
    let (along_nm, across_nm) = (i128::from(along_um) * 1000, i128::from(line) * i128::from(frame.spacing_nm));
    let round = |scaled: i128| (scaled + (500 << 30)).div_euclid(1000 << 30) as i32;
    [
        frame.origin_um[0] + round(ux * along_nm - uy * across_nm),
        frame.origin_um[1] + round(uy * along_nm + ux * across_nm),
    ]
}
