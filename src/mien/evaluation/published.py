"""Published results of other methods."""

TABLE_1 = (
    ("La Cascia et al., 2000", "75", "5.3", "5.6", "3.8", "3.9"),
    ("Xiao et al., 2003", "100", "3.8", "3.2", "1.4", "2.8"),
    ("Lefevre et al., 2009", "100", "4.4", "3.3", "2.0", "3.2"),
    ("Morency et al., 2008", "100", "5.0", "3.7", "2.9", "3.9"),
    ("Saragih et al., 2011", "100", "4.3 ± 2.2", "4.8 ± 3.3", "2.6 ± 1.4", "3.9"),
    ("Chen et al., 2006", "91", "5.5 ± 1.7", "4.2 ± 1.5", "2.1 ± 1.0", "3.9"),
    ("Tran et al. (the paper)", "100", "5.4 ± 2.2", "3.9 ± 1.7", "2.4 ± 1.4", "3.9"),
)
"""The paper's Table 1 as printed, on the uniform-light set of BUFT: P_s in per cent, E_pan, E_tilt, E_roll,
E_avg in degrees."""
AS_PRINTED = "The E_m of La Cascia et al. is as printed; the mean of their three angles is 4.9. "
"""A remark on `TABLE_1`."""

REBASED_REFERENCES = (
    ("CLM", "4.30", "2.99", "2.58", "3.29"),
    ("CLNF (OpenFace)", "3.35", "2.78", "2.45", "2.86"),
    ("CE-CLM (OpenFace 2)", "3.25", "2.40", "2.41", "2.69"),
)
"""Published for OpenFace's evaluation of BUFT: E_pan, E_tilt, E_roll and their mean in degrees; those of OpenFace in
`matlab_runners/Head Pose Experiments/results` of its repository, as `Pose_OF_CLNF.txt` and `Pose_OF_CECLM.txt`."""
