/PROG ROBODK
/ATTR
/MN
  1:L P[1] 1000mm/sec FINE ;
  2:J P[2] 100% FINE ;
  3:A P[3] 100mm/sec FINE ;
  4:A P[4] 100mm/sec FINE ;
/POS
P[1]{
 GP1:
  UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',
  X = 200.000 mm, Y = 235.485 mm, Z = 1499.9171 mm,
  W = 0 deg, P = -0.098 deg, R = -90.045 deg
};
P[2]{
 GP1:
  UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',
  X = 0.250 mm, Y = 235.485 mm, Z = 1499.9171 mm,
  W = 0 deg, P = -0.098 deg, R = -90.045 deg
};
P[3]{
 GP1:
  UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',
  X = -0.500 mm, Y = 235.485 mm, Z = 1499.9171 mm,
  W = 0 deg, P = -0.098 deg, R = -90.045 deg
};
P[4]{
 GP1:
  UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',
  X = 1000.000 mm, Y = 235.485 mm, Z = 1499.9171 mm,
  W = 0 deg, P = -0.098 deg, R = -90.045 deg
};
/END
