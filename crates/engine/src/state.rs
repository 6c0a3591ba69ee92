//! State of a training on the host: parameters, moments and measurements.

use crate::density::DensityStats;
use relume_scene::{Gaussians, MAX_LIGHTS, Model};

/// First and second moments of Adam, shaped like the model.
#[derive(Debug, Clone, PartialEq)]
pub struct Moments {
    /// First moments of the Gaussians.
    pub first: Gaussians,
    /// Second moments of the Gaussians.
    pub second: Gaussians,
    /// First and second moments of prototypes, then environment texels.
    pub globals: [Vec<[f32; 3]>; 2],
}

impl Moments {
    /// Zero moments for `model`.
    pub fn zeroed(model: &Model) -> Self {
        let g = &model.gaussians;
        let zero = Gaussians::zeroed(g.len(), g.prototypes(), g.visibility_degree(), g.radiance_degree());
        let globals = vec![[0.0; 3]; model.prototypes.len() + model.env_raw.len()];
        Self { first: zero.clone(), second: zero, globals: [globals.clone(), globals] }
    }

    /// Keeps the moments of the Gaussians at `indices`; new Gaussians (`None`) get zero moments.
    pub fn gather(&mut self, indices: &[Option<usize>]) {
        let pick: Vec<usize> = indices.iter().map(|i| i.unwrap_or(0)).collect();
        for moments in [&mut self.first, &mut self.second] {
            let mut picked = moments.gathered(&pick);
            for (_, width, data) in picked.fields_mut() {
                for (row, _) in data.chunks_mut(width.max(1)).zip(indices).filter(|(_, i)| i.is_none()) {
                    row.fill(0.0);
                }
            }
            *moments = picked;
        }
    }
}

/// State of a training: everything that it has learned and measured.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainState {
    /// The model.
    pub model: Model,
    /// Optimiser moments.
    pub moments: Moments,
    /// Density statistics since the last round.
    pub density: DensityStats,
    /// Probe labels, `[Gaussian][coefficient]`; empty before the first measurement.
    pub labels: Vec<f32>,
    /// Gathered light: irradiance and blocked radiance, `[rotation of the light][Gaussian][6]`; empty before the first
    /// measurement.
    pub gathered: Vec<[f32; 6]>,
    /// Arriving share of each of the model's lights, `[Gaussian][light]`; empty, which means 1, before the first
    /// measurement.
    pub arriving: Vec<[f32; MAX_LIGHTS]>,
}

impl TrainState {
    /// Gathered light under one rotation of the light, `[Gaussian]`; empty where it was not measured.
    pub fn gathered_in(&self, block: usize) -> &[[f32; 6]] {
        self.gathered.chunks(self.model.gaussians.len().max(1)).nth(block).unwrap_or(&[])
    }

    /// Keeps only the Gaussians at `indices`, with their moments, statistics and measurements.
    pub fn select(&mut self, indices: &[usize]) {
        let n = self.model.gaussians.len().max(1);
        let width = self.labels.len() / n;
        self.model.gaussians = self.model.gaussians.gathered(indices);
        self.moments.gather(&indices.iter().map(|i| Some(*i)).collect::<Vec<_>>());
        self.density = DensityStats {
            absgrad: indices.iter().map(|i| self.density.absgrad[*i]).collect(),
            seen: indices.iter().map(|i| self.density.seen[*i]).collect(),
        };
        if width > 0 {
            let row = |i: &usize| self.labels[i * width..(i + 1) * width].iter().copied();
            self.labels = indices.iter().flat_map(row).collect();
        }
        if !self.gathered.is_empty() {
            let blocks = self.gathered.chunks_exact(n);
            self.gathered = blocks.flat_map(|block| indices.iter().map(|i| block[*i])).collect();
        }
        if !self.arriving.is_empty() {
            self.arriving = indices.iter().map(|i| self.arriving[*i]).collect();
        }
    }

    /// The start state of an initial model.
    pub fn new(model: Model) -> Self {
        Self {
            moments: Moments::zeroed(&model),
            density: DensityStats::zeroed(model.gaussians.len()),
            labels: Vec::new(),
            gathered: Vec::new(),
            arriving: Vec::new(),
            model,
        }
    }
}
