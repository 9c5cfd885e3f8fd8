//! Triangles as strips.

/// The triangles as strips: runs of nodes of which every three that follow each other are a triangle, every
/// second one turned about. All triangles keep their orientation; those that name a node that is not there
/// are left out.
///
/// A strip begins at the first triangle that is left and goes on over the last edge as long as there is a
/// neighbour; of the three that can begin there, the longest is taken. The mesh of a vessel becomes about one
/// strip a ring.
pub(super) fn strips(triangles: &[[u32; 3]], nodes: usize) -> Vec<Vec<u32>> {
    let mut left = Left::of(triangles, nodes);
    let mut strips = Vec::new();
    for (first, &[a, b, c]) in triangles.iter().enumerate() {
        if !left.is_left[first] {
            continue;
        }
        let begun = [[a, b, c], [b, c, a], [c, a, b]].map(|start| {
            let (strip, taken) = left.take_strip(first, start);
            left.give_back(&taken);
            (strip, taken)
        });
        let longest = begun.into_iter().rev().max_by_key(|(strip, _)| strip.len());
        if let Some((strip, taken)) = longest {
            taken.iter().for_each(|&triangle| left.is_left[triangle] = false);
            strips.push(strip);
        }
    }
    strips
}

/// The triangles that are in no strip yet, by their edges.
struct Left<'a> {
    triangles: &'a [[u32; 3]],
    is_left: Vec<bool>,
    /// Where the edges of each node begin; one more for the end.
    starts: Vec<u32>,
    /// Of the edges that leave a node: the triangle, and which of its edges this is.
    edges: Vec<(u32, u8)>,
}

impl<'a> Left<'a> {
    fn of(triangles: &'a [[u32; 3]], nodes: usize) -> Self {
        let is_left: Vec<bool> =
            triangles.iter().map(|t| t.iter().all(|&node| (node as usize) < nodes)).collect();
        let there = || triangles.iter().zip(0_u32..).filter(|(_, k)| is_left[*k as usize]);
        let mut starts = vec![0_u32; nodes + 1];
        there().flat_map(|(t, _)| t).for_each(|&node| starts[node as usize + 1] += 1);
        for node in 0..nodes {
            starts[node + 1] += starts[node];
        }
        let mut next = starts.clone();
        let mut edges = vec![(0, 0); starts[nodes] as usize];
        for (t, k) in there() {
            for (&node, corner) in t.iter().zip(0..) {
                let place = &mut next[node as usize];
                edges[*place as usize] = (k, corner);
                *place += 1;
            }
        }
        Self { triangles, is_left, starts, edges }
    }

    /// Takes triangles from `first` on, whose corners are `start`, and returns the strip's nodes and its
    /// triangles.
    fn take_strip(&mut self, first: usize, start: [u32; 3]) -> (Vec<u32>, Vec<usize>) {
        let (mut strip, mut taken) = (start.to_vec(), vec![first]);
        self.is_left[first] = false;
        while let [.., p, q] = strip[..] {
            // The neighbour runs along the shared edge the other way; every second triangle of a strip is
            // turned about.
            let (from, to) = if strip.len() % 2 == 1 { (q, p) } else { (p, q) };
            let Some((triangle, node)) = self.along(from, to) else { break };
            self.is_left[triangle] = false;
            taken.push(triangle);
            strip.push(node);
        }
        (strip, taken)
    }

    fn give_back(&mut self, taken: &[usize]) {
        taken.iter().for_each(|&triangle| self.is_left[triangle] = true);
    }

    /// A triangle that runs along an edge, and its third node.
    fn along(&self, from: u32, to: u32) -> Option<(usize, u32)> {
        let range = self.starts[from as usize] as usize..self.starts[from as usize + 1] as usize;
        self.edges[range].iter().find_map(|&(triangle, corner)| {
            let triangle = triangle as usize;
            let node = |k: u8| self.triangles[triangle][usize::from((corner + k) % 3)];
            (self.is_left[triangle] && node(1) == to).then(|| (triangle, node(2)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::strips;

    /// The triangles of strips, each begun at its smallest node, sorted.
    fn triangles_of(strips: &[Vec<u32>]) -> Vec<[u32; 3]> {
        let of = |strip: &Vec<u32>| -> Vec<[u32; 3]> {
            let triples = strip.windows(3).enumerate();
            triples.map(|(k, t)| if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] }).collect()
        };
        sorted(&strips.iter().flat_map(of).collect::<Vec<_>>())
    }

    fn sorted(triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
        let turned = |t: &[u32; 3]| {
            let first = (0..3).min_by_key(|&k| t[k]).unwrap_or(0);
            [t[first], t[(first + 1) % 3], t[(first + 2) % 3]]
        };
        let mut all: Vec<[u32; 3]> = triangles.iter().map(turned).collect();
        all.sort_unstable();
        all
    }

    fn tube(nodes: u32, rings: u32) -> Vec<[u32; 3]> {
        let mut triangles = Vec::new();
        for ring in 0..rings - 1 {
            for j in 0..nodes {
                let (a, b) = (ring * nodes + j, ring * nodes + (j + 1) % nodes);
                triangles.extend([[a, b, b + nodes], [a, b + nodes, a + nodes]]);
            }
        }
        triangles
    }

    #[test]
    fn strips_are_the_same_triangles_with_the_same_orientation() {
        let whole = tube(16, 9);
        let holes: Vec<_> =
            whole.iter().copied().enumerate().filter(|(k, _)| k % 7 > 1).map(|(_, t)| t).collect();
        let alone = vec![[0, 1, 2], [3, 4, 5]];
        let about_an_edge = vec![[0, 1, 2], [1, 0, 3], [0, 1, 4], [2, 2, 1]];
        for triangles in [whole.clone(), holes, alone, about_an_edge, Vec::new()] {
            assert_eq!(triangles_of(&strips(&triangles, 16 * 9)), sorted(&triangles));
        }
        let mut turned = whole.clone();
        turned[3].swap(0, 1);
        assert_ne!(triangles_of(&strips(&turned, 16 * 9)), sorted(&whole), "the comparison sees orientation");
        assert!(strips(&whole, 16 * 9).len() <= 8, "one strip a ring");
        assert!(strips(&[[0, 1, 9]], 9).is_empty());
    }
}
