//! Encoding and decoding of layers, in pixels a second. `cargo bench --bench encoding`

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use layerd::device::encoding::{Decoder, depth_of, encode};
use layerd::link::message::Encoding;
use layerd::slice::{Bitmap, Depth};

const WIDTH_PX: u32 = 3840;
const HEIGHT_PX: u32 = 2160;

fn main() {
    divan::main();
}

/// Discs of many sizes on a grid, about a tenth lit, edges a pixel wide: a cut through a dense lattice.
fn layer(depth: Depth) -> Bitmap {
    let mut bitmap = Bitmap::new(WIDTH_PX, HEIGHT_PX, depth);
    let stride = bitmap.stride_bytes();
    for y in 0..HEIGHT_PX as usize {
        for x in 0..WIDTH_PX as usize {
            let (column, row) = (x / 64, y / 64);
            let radius = 9.0 + ((column * 7 + row * 13) % 11) as f64 * 0.7;
            let offset = ((column * 5 + row * 3) % 7) as f64;
            let (dx, dy) = ((x % 64) as f64 - 29.0 - offset, (y % 64) as f64 - 35.0 + offset);
            let covered = (radius - dx.hypot(dy) + 0.5).clamp(0.0, 1.0);
            match depth {
                Depth::Grey => bitmap.data_mut()[y * stride + x] = (covered * 255.0).round() as u8,
                Depth::Bit if covered >= 0.5 => bitmap.data_mut()[y * stride + x / 8] |= 0x80 >> (x % 8),
                Depth::Bit => {}
            }
        }
    }
    bitmap
}

#[divan::bench(args = [Encoding::RawBit, Encoding::Group4, Encoding::RawGrey, Encoding::RunGrey])]
fn encode_layer(bencher: Bencher<'_, '_>, encoding: Encoding) {
    let bitmap = layer(depth_of(encoding));
    let mut bytes = Vec::new();
    bencher.counter(ItemsCount::new(WIDTH_PX * HEIGHT_PX)).bench_local(|| {
        encode(black_box(&bitmap), encoding, &mut bytes).expect("the depth fits");
    });
    eprintln!("  {encoding:?}: {} bytes", bytes.len());
}

#[divan::bench(args = [Encoding::RawBit, Encoding::Group4, Encoding::RawGrey, Encoding::RunGrey])]
fn decode_layer(bencher: Bencher<'_, '_>, encoding: Encoding) {
    let mut bytes = Vec::new();
    encode(&layer(depth_of(encoding)), encoding, &mut bytes).expect("the depth fits");
    bencher.counter(ItemsCount::new(WIDTH_PX * HEIGHT_PX)).bench_local(|| {
        let mut decoder = Decoder::new(encoding, WIDTH_PX, HEIGHT_PX);
        for piece in bytes.chunks(1000) {
            decoder.push(piece).expect("its own bytes");
        }
        decoder.finish().expect("a whole picture")
    });
}
