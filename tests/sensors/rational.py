"""Ranks over the rationals, from heat balances written out here: nothing of the package, no rounding, no prime."""

from fractions import Fraction

from tests.truth.string import TABLE_1


def rates_matrix(n, R_cc=None, C_f=None, R_u=None):
    """A of n cells as fractions; None is no conduction, a stream that does not warm up, R_u of Table 1."""
    C_c, C_s, _, R_c, common = (Fraction(v) for v in TABLE_1.values())
    outside = [Fraction(x) for x in R_u] if R_u is not None else [common] * n
    g = 1 / Fraction(R_cc) if R_cc else Fraction(0)

    def rates(x):
        T_c, T_s = x[0::2], x[1::2]
        stream, out = Fraction(0), []
        for k in range(n):
            around = [j for j in (k - 1, k + 1) if 0 <= j < n]
            into = (stream - T_s[k]) / outside[k] + (T_c[k] - T_s[k]) / R_c
            into += sum(g * (T_s[j] - T_s[k]) for j in around)
            out += [(T_s[k] - T_c[k]) / R_c / C_c, into / C_s]
            if C_f:
                stream += (T_s[k] - stream) / (outside[k] * Fraction(C_f))
        return out

    columns = [rates([Fraction(int(i == j)) for i in range(2 * n)]) for j in range(2 * n)]
    return [list(row) for row in zip(*columns, strict=True)]


def rank(A, sensors):
    """Rank of [C; CA; CA²; …] by Gaussian elimination, row after row of each sensor until one adds nothing."""
    N = len(A)
    rows = []  # (pivot, row), rows in echelon form
    for k in sensors:
        row = [Fraction(int(j == 2 * k - 1)) for j in range(N)]
        while True:
            left = list(row)
            for pivot, other in rows:
                if factor := left[pivot]:
                    left = [a - factor * b for a, b in zip(left, other, strict=True)]
            pivot = next((j for j, x in enumerate(left) if x), None)
            if pivot is None:
                break
            left = [x / left[pivot] for x in left]
            rows.append((pivot, left))
            # what was reduced spans the same with the others, and its numbers stay shorter
            row = [sum(left[i] * A[i][j] for i in range(N) if left[i]) for j in range(N)]
    return len(rows)
