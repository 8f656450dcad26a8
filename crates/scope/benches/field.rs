//! Benchmark of the computation of the wall field of a curved tube: three runs, on `RAYON_NUM_THREADS` threads.
//!
//! `cargo bench -p carina-scope --bench field` creates the mesh; a file of vertices (f64) and a file of triangles (u32)
//! as arguments replace it.

use std::time::Instant;

use carina_scope::WallField;

type Mesh = (Vec<[f64; 3]>, Vec<[u32; 3]>);

fn spiral() -> Mesh {
    /// Number of rings of vertices of the tube's mesh.
    const ROWS: usize = 1600;
    /// Number of vertices of each ring.
    const ROUND: usize = 24;
    let mut vertices = Vec::new();
    for row in 0..ROWS {
        let along = row as f64 / ROWS as f64;
        let turn = 5.0 * std::f64::consts::TAU * along;
        let middle = [
            40.0 * libm::cos(turn),
            40.0 * libm::sin(turn),
            200.0 * along,
        ];
        let out = [libm::cos(turn), libm::sin(turn), 0.0];
        let end = row == 0 || row + 1 == ROWS;
        let radius = if end {
            0.01
        } else {
            3.0 + libm::sin(30.0 * along)
        };
        for n in 0..ROUND {
            let round = std::f64::consts::TAU * n as f64 / ROUND as f64;
            let (across, up) = (radius * libm::cos(round), radius * libm::sin(round));
            vertices.push([
                middle[0] + across * out[0],
                middle[1] + across * out[1],
                middle[2] + up,
            ]);
        }
    }
    let at = |row: usize, n: usize| (row * ROUND + n % ROUND) as u32;
    let mut triangles = Vec::new();
    for n in 0..ROUND {
        for row in 0..ROWS - 1 {
            triangles.push([at(row, n), at(row + 1, n + 1), at(row + 1, n)]);
            triangles.push([at(row, n), at(row, n + 1), at(row + 1, n + 1)]);
        }
        for (row, sign) in [(0, 0), (ROWS - 1, 1)] {
            let (a, b) = (at(row, n), at(row, n + 1));
            let c = at(row, 0);
            triangles.push(if sign == 0 { [c, b, a] } else { [c, a, b] });
        }
    }
    (vertices, triangles)
}

fn read() -> Option<Mesh> {
    let mut names = std::env::args().skip(1).filter(|a| !a.starts_with("--"));
    let (vertices, triangles) = (
        std::fs::read(names.next()?).ok()?,
        std::fs::read(names.next()?).ok()?,
    );
    let number = |at: usize| {
        f64::from_le_bytes(
            vertices[8 * at..8 * at + 8]
                .try_into()
                .expect("eight bytes"),
        )
    };
    let place = |at: usize| {
        u32::from_le_bytes(
            triangles[4 * at..4 * at + 4]
                .try_into()
                .expect("four bytes"),
        )
    };
    Some((
        (0..vertices.len() / 24)
            .map(|n| [number(3 * n), number(3 * n + 1), number(3 * n + 2)])
            .collect(),
        (0..triangles.len() / 12)
            .map(|n| [place(3 * n), place(3 * n + 1), place(3 * n + 2)])
            .collect(),
    ))
}

fn main() {
    let (vertices, triangles) = read().unwrap_or_else(spiral);
    println!(
        "{} triangles, {} threads",
        triangles.len(),
        rayon::current_num_threads()
    );
    for _ in 0..3 {
        let began = Instant::now();
        let field = WallField::from_mesh(&vertices, &triangles, 0.4, &|_| true);
        let megabytes = field.map_or(0.0, |f| f.num_bytes() as f64 / 1e6);
        println!(
            "{:.0} ms, {megabytes:.1} MB",
            began.elapsed().as_secs_f64() * 1e3
        );
    }
}
