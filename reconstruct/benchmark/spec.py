"""What NerfBaselines is told about Koala. It finds this module by the entry point `nerfbaselines.specs` of an installed Koala."""

from nerfbaselines import register  # pyright: ignore[reportMissingImports]  an environment of its own has it

register(
    {
        "id": "koala",
        "method_class": "koala3d.reconstruct.benchmark.method:Koala",
        "metadata": {
            "name": "Koala (Surf-NeRF)",
            "description": "Reconstruction of shiny objects after Surf-NeRF: Ref-NeRF's reflection model on a permutohedral "
            "lattice, with regularisers near the first surface. Settings of Koala are overrides: --set train.steps=25000; "
            "so are --set model=NAME and --set preset=paper.",
            "paper_title": "Surf-NeRF: Surface Regularised Neural Radiance Fields",
            "paper_authors": ["J. Naylor", "V. Ila", "D. G. Dansereau"],
            "paper_link": "https://arxiv.org/abs/2411.18652",
        },
    }
)
