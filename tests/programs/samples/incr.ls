/PROG  INCR
/ATTR
/MN
   1:J P[1] 100% FINE    ;
   2:L P[2] 100mm/sec FINE INC    ;
   3:L P[1] 100mm/sec FINE Tool_Offset,PR[81:Z-20mm]    ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   600.000  mm,	Y =      .000  mm,	Z =   500.000  mm,
	W =   180.000 deg,	P =      .000 deg,	R =      .000 deg
};
P[2]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =      .000  mm,	Y =      .000  mm,	Z =    10.000  mm,
	W =      .000 deg,	P =      .000 deg,	R =      .000 deg
};
/END
