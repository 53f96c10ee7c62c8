"""What a picture looks like in one vector, which finds the pictures that are worth a closer look (VLAD, Jegou et al. 2010).

Descriptors are assigned to words, and what they differ by from their word is summed for each word. Sums are brought to unit
length word by word (Arandjelovic and Zisserman 2013), so that a texture that repeats does not outweigh the rest.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.process.pictures.features import PictureFeatures

WORDS = 64
SAMPLE, ROUNDS = 20_000, 10
"""Descriptors from which words are learned, and rounds of k-means."""
USED = 1000
"""Descriptors of a picture that count, those of the highest contrast."""


def likeliest(features: Sequence[PictureFeatures], count: int) -> set[tuple[int, int]]:
    """Pairs of indices, the first smaller: of each picture the `count` others that look most like it."""
    vectors = looks(features)
    pairs = set()
    for index, vector in enumerate(vectors):
        likeness = vectors @ vector
        likeness[index] = -np.inf
        nearest = np.argpartition(-likeness, count - 1)[:count] if count < len(vectors) else np.arange(len(vectors))
        pairs |= {(min(index, int(other)), max(index, int(other))) for other in nearest if other != index}
    return pairs


def looks(features: Sequence[PictureFeatures]) -> NDArray[np.float32]:
    """(pictures, words * 128) vectors of unit length; zero for a picture without features."""
    chosen = [unit(one.descriptors[:USED].astype(np.float32)) for one in features]
    words = _words(np.concatenate(chosen))
    result = np.zeros((len(chosen), WORDS, words.shape[1]), np.float32)
    for vector, descriptors in zip(result, chosen, strict=True):
        word = (descriptors @ words.T - (words**2).sum(1) / 2).argmax(1)
        np.add.at(vector, word, descriptors - words[word])
    return unit(unit(result).reshape(len(chosen), -1))


def _words(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(words, 128) means of descriptors that are alike, by k-means from a fixed seed."""
    random = np.random.default_rng(0)
    sample = descriptors[random.permutation(len(descriptors))[:SAMPLE]]
    words = sample[random.integers(len(sample), size=WORDS)] if len(sample) else np.zeros((WORDS, 128), np.float32)
    for _ in range(ROUNDS):
        word = (sample @ words.T - (words**2).sum(1) / 2).argmax(1)
        sums, counts = np.zeros_like(words), np.bincount(word, minlength=WORDS)
        np.add.at(sums, word, sample)
        words = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], words)
    return words


def unit(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(..., n) vectors of unit length; zero for those without any."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6)
