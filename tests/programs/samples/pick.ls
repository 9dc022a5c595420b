/PROG  PICK
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "Prise pièce";
PROG_SIZE	= 1204;
CREATE		= DATE 21-07-15  TIME 10:11:12;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      TASK_PRIORITY	= 50;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/MN
   1:  !Vérifier l'outil P[9] ;
   2:  UFRAME_NUM=1 ;
   3:  UTOOL_NUM=3 ;
   4:J P[1] 100% CNT50    ;
   5:L P[2:Prise] 500mm/sec FINE    ;
   6:L P[2:Prise] 500mm/sec FINE Offset,PR[23:offs Z80]    ;
   7:C P[3]
    :  P[4] 100mm/sec FINE    ;
   8:  //J P[1] 100% FINE    ;
   9:L PR[5:retrait] 500mm/sec FINE    ;
  10:J P[R[1]] 100% FINE    ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 3,		CONFIG : 'N U T, 0, 0, 0',
	X =  -258.768  mm,	Y =   397.980  mm,	Z =  1033.305  mm,
	W =    89.999 deg,	P =      .002 deg,	R =     2.111 deg
};
P[2:"Prise"]{
   GP1:
	UF : 1, UT : 3,		CONFIG : 'N U T, 0, 0, 0',
	X =   534.015  mm,	Y =   478.032  mm,	Z =   637.000  mm,
	W =     -.098 deg,	P =    19.856 deg,	R =  -179.900 deg
};
P[3]{
   GP1:
	UF : 0, UT : 3,		CONFIG : 'N U T, 0, 0, 0',
	X =   100.000  mm,	Y =      .500  mm,	Z =     -.250  mm,
	W =   180.000 deg,	P =      .000 deg,	R =   -90.045 deg
};
P[4]{
   GP1:
	UF : 1, UT : 3,		CONFIG : 'F U T, 0, -1, 1',
	X =   110.000  mm,	Y =    20.000  mm,	Z =    30.000  mm,
	W =  -180.000 deg,	P =      .000 deg,	R =    90.000 deg
};
/END
