"""Least squares in which every view has six unknowns of its own beside the global ones.

Rows of a view touch its own unknowns v and the global ones g alone. An orthogonal decomposition of those rows,

    Q^T [rows by v | rows by g | targets] = [ A  B  a ]
                                            [ 0  C  c ],

leaves C g = c for the global unknowns and A v = a - B g for the view (Golub & Van Loan, Matrix Computations, 5.3; Triggs et
al. 2000, section 6.1, has the same with normal equations). Unlike a Schur complement nothing is subtracted, so that corners a
thousand times more certain than the arm's reports cost no digits.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from koala3d.calib.arrays import Array, Indices


@dataclass(frozen=True)
class Eliminated:
    """The problem after every view's unknowns are expressed by the global ones; p global unknowns."""

    root: Array  # (p, p) upper triangular; root.T @ root is the information on the global unknowns
    side: Array  # (p,) the least-squares step solves root @ step = side
    own: Array  # (views, 6, 6) upper triangular A
    coupling: Array  # (views, 6, p) B
    own_side: Array  # (views, 6) a

    @property
    def information(self) -> Array:
        """(p, p) inverse of the covariance of the global unknowns."""
        return self.root.T @ self.root

    def step(self, damping: float) -> tuple[Array, Array]:
        """(p,) step of the global unknowns and (views, 6) of the others.

        The global step is damped in proportion to what is known of each unknown (Marquardt 1963). Raises LinAlgError where the
        damped system is singular.
        """
        scale = np.linalg.norm(self.root, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        rows = np.vstack([self.root / scale, np.sqrt(damping) * np.eye(len(scale))])
        orthogonal, triangle = np.linalg.qr(rows)
        step = solve_triangular(triangle, orthogonal[: len(scale)].T @ self.side, check_finite=False) / scale
        if not np.isfinite(step).all():
            raise np.linalg.LinAlgError("singular")
        own = np.linalg.solve(self.own, (self.own_side - self.coupling @ step)[..., None])[..., 0]
        return step, own

    def own_covariances(self, covariance: Array) -> Array:
        """(views, 6, 6) covariances of the views' unknowns, given the (p, p) `covariance` of the global ones."""
        inverse = np.linalg.inv(self.own)
        by_global = inverse @ self.coupling
        return inverse @ np.swapaxes(inverse, 1, 2) + by_global @ covariance @ np.swapaxes(by_global, 1, 2)


def eliminate(view: Indices, rows: Array, own_rows: Array, global_rows: Array) -> Eliminated:
    """Eliminate the views' unknowns.

    Args:
        view: (n,) view of each corner; each corner has two rows.
        rows: (n, 2, 6 + p + 1) derivatives by the view's unknowns and by the global ones, and targets; all whitened.
        own_rows: (views, 6, 6 + 1) what is known of each view's unknowns: rows and targets.
        global_rows: (k, p + 1) what is known of the global unknowns: rows and targets.
    """
    views, width = len(own_rows), rows.shape[-1]
    counts = np.bincount(view, minlength=views)
    rank = np.empty(len(view), np.int64)  # of each corner among those of its view
    rank[np.argsort(view, kind="stable")] = np.arange(len(view)) - np.repeat(np.cumsum(counts) - counts, counts)
    padded = np.zeros((views, 6 + 2 * counts.max(initial=0), width))
    padded[:, :6, :6], padded[:, :6, -1] = own_rows[..., :6], own_rows[..., 6]
    padded[view, 6 + 2 * rank], padded[view, 7 + 2 * rank] = rows[:, 0], rows[:, 1]
    triangles = np.asarray(np.linalg.qr(padded, mode="r"))
    rest = triangles[:, 6:, 6:].reshape(-1, width - 6)
    whole = np.asarray(np.linalg.qr(np.vstack([rest, global_rows, np.zeros((width - 6, width - 6))]), mode="r"))
    return Eliminated(whole[:-1, :-1], whole[:-1, -1], triangles[:, :6, :6], triangles[:, :6, 6:-1], triangles[:, :6, -1])


def covariance_of(information: Array) -> Array:
    """(p, p) inverse of an information, which is scaled before it is inverted: pixels and radians are far apart."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    return np.asarray(np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale), np.float64)
