"""Wrong texts: an operator, an index, a missing clamp, a cell, an order; each with who catches it.

``cases``: of the suite, one of which fails. None: the twin, whose joint law then differs.
"""

from typing import NamedTuple


class TextMutant(NamedTuple):
    """In ``file``, ``right`` becomes ``wrong`` where it stands first."""

    file: str
    right: str
    wrong: str
    cases: tuple[int, ...] | None


def _mutants(file: str, *rows: tuple[str, str, tuple[int, ...] | None]) -> list[TextMutant]:
    return [TextMutant(file, *row) for row in rows]


MUTANTS = [
    *_mutants(
        "session.st",
        ("stHeader.payload_bytes <> LR_PAYLOAD_BYTES[LIMIT(1, stHeader.kind, 12)]", "FALSE", (104,)),
        ("stHeader.major <> 1", "FALSE", (112,)),
        ("stHeader.crc32 <> F_LR_DatagramCrc", "stHeader.crc32 = 0 * F_LR_DatagramCrc", (109, 110, 111)),
        ("(wFlags AND WORD#16#FF00) <> WORD#0", "FALSE", (116, 117, 118)),
        ("stLink.nNow_ns < stLink.nRationed_ns + LR_RATION_NS", "FALSE", (112, 216, 223, 244, 245)),
        ("stLink.aNonces[i] = stHello.client_nonce", "FALSE", (208, 210, 255)),
        ("stHello.arm_hash <> LR_ARM_HASH", "FALSE", (206, 207, 230, 242)),
        ("(stLink.stOpen.nNumber <> 0) AND NOT xConnected", "FALSE", (211, 212, 213, 214, 215)),
        ("stHello.header.sent_ns < stLink.stOpen.nHelloSent_ns", "FALSE", (215,)),
        ("stSession.nSequence := stSession.nSequence + 1;", "", (133, 134, 307, 309)),
        ("stLink.nLost := stLink.nLost + nSkipped;", "", (302, 303, 304, 591)),
        ("stLink.nLost := stLink.nLost - 1;", "", (303, 304, 321, 323, 591)),
        (
            "stSession.nAge_ns > UDINT_TO_ULINT",
            "stSession.nAge_ns > 9 * UDINT_TO_ULINT",
            (313, 314, 316, 325),
        ),
        ("stReply.received_ns := stLink.nNow_ns;", "", (317, 318, 422)),
    ),
    *_mutants(
        "requests.st",
        ("stLink.stOpen.aAnswers[i].dwContent <> dwContent", "FALSE", (404, 419, 433)),
        ("nId < stLink.stOpen.nNewestId", "FALSE", (405,)),
        ("ELSIF stLink.stOpen.aAnswers[i].xDecided THEN", "ELSIF FALSE THEN", (402,)),
        ("stLink.aQueue[i].nId < nNewest", "FALSE", (420, 531)),
        ("stLink.stRead.nCode > 8", "FALSE", (431, 432, 444)),
        ("stLink.stRead.nCount > 24", "stLink.stRead.nCount > 25", (124, 125, 431, 432, 444)),
        ("stLink.aCopy[i] := 0;", "", (404, 419, 433, 120, 130, 252)),
        ("lwNeeds := ULINT_TO_LWORD(LR_PATHS);", "", (205, 445, 532)),
        (
            "nAhead := stCame.stData.number - stLink.stStreamed.stData.number;",
            "nAhead := 0;",
            (586, 550, 556),
        ),
    ),
    *_mutants(
        "group.st",
        ("eSeverity := E_LR_Severity.STOP;", "", (534,)),
        ("fAge > LR_STREAM_MAX_AGE_S", "FALSE", (549, 584)),
        ("nAhead >= UDINT#16#80000000", "FALSE", (548, 585)),
        ("F_LR_Norm(x := aWay) > LR_STREAM_DISTANCE_M", "FALSE", (546, 547, 580, 581)),
        ("fLimit := LR_STREAM_CLOSE_S;", "fLimit := 4.0 * LR_STREAM_CLOSE_S;", (572, 573, 574, 575)),
        ("stArm.stStream.fFade + fDt / LR_STREAM_RAMP_S", "stArm.stStream.fFade", (575,)),
        ("stArm.stStream.aTwist[i] := 0.0;", "", (555, 587, 588)),
    ),
    *_mutants(
        "survey.st",
        ("F_LR_Norm(x := aWay) > LR_MOTION_FIRST_POINT_DISTANCE", "FALSE", (525, 526, 560, 564)),
        ("aq[i] < stSurvey.stSpace.aRange[0, i]", "FALSE", (566,)),
        ("fLeast < LR_SINGULAR_VALUE_MIN", "FALSE", (567,)),
        ("fMost <= LR_TIME_TOLERANCE;", "TRUE;", (563, 565, 568, 525, 526)),
    ),
    *_mutants(
        "motion.st",
        ("stMotion.fTime >= stArm.stPath.fDuration", "stMotion.fTime >= 0.0", (516, 517, 524, 527, 558)),
        ("stArm.stMotion.xDone := TRUE;", "", (555,)),
    ),
    *_mutants(
        "kinematics.st",
        ("aJ[k + 3, i] := aZ[k];", "aJ[k + 3, i] := aR[k];", None),
        ("aFrames[i, k, 2] * LR_DH[i, 3]", "aFrames[i, k, 1] * LR_DH[i, 3]", None),
    ),
    *_mutants(
        "servo.st",
        ("- LR_DAMPING[i] * (aLoad[i]", "+ LR_DAMPING[i] * (aLoad[i]", None),
        ("LR_SERVO_FEED_FORWARD * stServo.aqdCmd[i]", "0.0", None),
        ("LIMIT(-LR_SERVO_LIMIT, fTarget, LR_SERVO_LIMIT)", "fTarget * 1.5", None),
        ("fDemand := stServo.aPt1[i];", "fDemand := fProportional;", None),
        ("aSpeeds[i, 1] := fRetract;", "aSpeeds[i, 1] := fExtend;", None),
        ("ABS(aError[i]) > LR_POSE_DEAD_ZONE", "TRUE", None),
    ),
]
